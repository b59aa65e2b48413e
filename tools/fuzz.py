"""Fuzz every decoder of external bytes, guided by coverage (atheris, a front end of libFuzzer).

    pip install atheris
    python tools/fuzz.py serial found -max_total_time=600
    python tools/fuzz.py serial found --keep

Targets: serial, can, command, can_command, truth. They are in fuzz_targets.py, which needs no atheris: the tests run
them on bytes from hypothesis, and on the inputs in tests/protocol/fuzz_corpus, one per line in hex. These go into the
folder, `found`, with those that reach new code; `--keep` writes the folder's back. Other arguments are libFuzzer's.
docs/evidence/robustness.md states what the fuzzer has found.
"""

from __future__ import annotations

import sys
from hashlib import sha1
from pathlib import Path

CORPUS = Path(__file__).resolve().parents[1] / "tests" / "protocol" / "fuzz_corpus"


def unpack(kept: Path, folder: Path) -> None:
    """Write the kept inputs as files, under the names that libFuzzer gives them."""
    folder.mkdir(parents=True, exist_ok=True)
    for line in kept.read_text().split():
        data = bytes.fromhex(line)
        (folder / sha1(data, usedforsecurity=False).hexdigest()).write_bytes(data)


def keep(kept: Path, folder: Path) -> None:
    """Write the files of a folder as lines, the shortest first."""
    inputs = sorted((path.read_bytes() for path in folder.iterdir()), key=lambda data: (len(data), data))
    kept.write_text("".join(f"{data.hex()}\n" for data in inputs if data))


def main() -> None:
    """Fuzz the target that the command line names."""
    import atheris

    with atheris.instrument_imports(include=["lidar_protocol", "lidar_emu.trajectory.live_datagram"]):
        from fuzz_targets import TARGETS
    name, folder, *options = (*sys.argv[1:], "", "")
    if name not in TARGETS or not folder or folder.startswith("-"):
        sys.exit(f"usage: fuzz.py {'|'.join(TARGETS)} FOLDER [--keep | options of libFuzzer]")
    kept = CORPUS / f"{name}.txt"
    if "--keep" in options:
        keep(kept, Path(folder))
        return
    unpack(kept, Path(folder))
    atheris.Setup([sys.argv[0], folder, *filter(None, options)], TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()

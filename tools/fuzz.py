"""Fuzz every decoder of external bytes and every reader of a user's files, guided by coverage (atheris, a front end of
libFuzzer).

    make fuzz SECONDS=600
    pip install atheris
    python tools/fuzz.py serial found -max_total_time=600
    python tools/fuzz.py serial found --keep

Targets of the wire are in fuzz_targets.py: serial, can, command, can_command, truth. Those of files are in
fuzz_files.py: trajectory, points, ply, obj, stl, tab, dsk, interface, scenario. Neither needs atheris: the tests run
them on the inputs in tests/protocol/fuzz_corpus and tests/files/fuzz_corpus, one per line in hex. These go into the
folder, `found`, with shipped files and what reaches new code; `--keep` writes the shortest of the folder back. Other
arguments are libFuzzer's.
docs/evidence/robustness.md states what the fuzzer has found.
"""

from __future__ import annotations

import logging
import sys
from hashlib import sha1
from itertools import accumulate
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
INSTRUMENTED = ["lidar_protocol", "lidar_emu", "ruamel", "tomllib"]
READERS = ["trajectory.live_datagram", "trajectory.table", "scene.mesh", "scene.terrain.read", "scenario"]
NO_READERS = ["scene.mesh.cast", "scene.mesh.ground", "scene.mesh.tree"]
"""Packages, of whose modules others would only slow the fuzzer: numba compiles no instrumented kernel at all."""
SHIPPED = {
    "interface": "protocol/lidar_protocol/*.toml",
    "scenario": "emulator/lidar_emu/shipped/scenarios/*.yaml",
}
KEPT_BYTES = 40_000
LIMITS = ["-timeout=20", "-rss_limit_mb=4096", "-max_len=16384"]
"""Of each input: seconds, and bytes."""


def left_out() -> list[str]:
    """Names of the emulator's modules that are no readers."""
    sources = ROOT / "emulator"
    names = (".".join(path.relative_to(sources).with_suffix("").parts) for path in sources.rglob("*.py"))
    read, others = (tuple(f"lidar_emu.{name}" for name in each) for each in (READERS, NO_READERS))
    return [name.removesuffix(".__init__") for name in names if not name.startswith(read) or name in others]


def unpack(kept: Path, folder: Path) -> None:
    """Write the kept inputs and shipped ones as files, under the names that libFuzzer gives them."""
    folder.mkdir(parents=True, exist_ok=True)
    inputs = [bytes.fromhex(line) for line in kept.read_text().split()]
    if kept.stem in SHIPPED:
        inputs += [path.read_bytes() for path in ROOT.glob(SHIPPED[kept.stem])]
    for data in inputs:
        (folder / sha1(data, usedforsecurity=False).hexdigest()).write_bytes(data)


def keep(kept: Path, folder: Path) -> None:
    """Write the files of a folder as lines, the shortest first, up to a limit."""
    inputs = sorted((path.read_bytes() for path in folder.iterdir()), key=lambda data: (len(data), data))
    ends = accumulate(len(data) for data in inputs)
    short = [data for data, end in zip(inputs, ends, strict=True) if data and end <= KEPT_BYTES]
    kept.write_text("".join(f"{data.hex()}\n" for data in short))


def main() -> None:
    """Fuzz the target that the command line names."""
    import atheris

    with atheris.instrument_imports(include=INSTRUMENTED, exclude=left_out()):
        from fuzz_files import TARGETS as FILES
        from fuzz_targets import TARGETS as WIRE
    name, folder, *options = (*sys.argv[1:], "", "")
    targets = WIRE | FILES
    if name not in targets or not folder or folder.startswith("-"):
        sys.exit(f"usage: fuzz.py {'|'.join(targets)} FOLDER [--keep | options of libFuzzer]")
    corpus = ROOT / "tests" / ("files" if name in FILES else "protocol") / "fuzz_corpus"
    kept, words = corpus / f"{name}.txt", corpus / "words.dict"
    if "--keep" in options:
        keep(kept, Path(folder))
        return
    unpack(kept, Path(folder))
    logging.disable(logging.WARNING)
    limits = [*LIMITS, f"-dict={words}"] if words.exists() else LIMITS
    atheris.Setup([sys.argv[0], *limits, folder, *filter(None, options)], targets[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()

"""Fuzz every decoder of external bytes, guided by coverage (atheris, a front end of libFuzzer).

    pip install atheris
    python tools/fuzz.py serial -max_total_time=600

Targets: serial, can, command, can_command, truth. They are in fuzz_targets.py, which needs no atheris: the tests run
them on bytes from hypothesis. Arguments after the target's name are passed to libFuzzer. docs/robustness.md states what
ten minutes of each have found.
"""

from __future__ import annotations

import sys


def main() -> None:
    """Fuzz the target that the command line names."""
    import atheris

    with atheris.instrument_imports(include=["lidar_protocol", "lidar_emu.trajectory.live_datagram"]):
        from fuzz_targets import TARGETS
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in TARGETS:
        sys.exit(f"usage: fuzz.py {'|'.join(TARGETS)} [options of libFuzzer]")
    atheris.Setup([sys.argv[0], *sys.argv[2:]], TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()

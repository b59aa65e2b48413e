"""The command `lidar-emu`, also as `python -m lidar_emu`."""

from __future__ import annotations

import sys


def main() -> None:
    """Run it; Ctrl-C ends it quietly, even while it is being loaded."""
    try:
        from lidar_emu.cli import main as command

        command()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()

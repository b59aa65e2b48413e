"""The command `lidar-emu`, also as `python -m lidar_emu`."""

from __future__ import annotations

import signal
import sys
import warnings

# NumPy's warnings of overflow and of empty slices are for those who write the code. Here, so that spawned processes,
# which import the main module, are silent too; at the end of the list, so that `python -W error` still sees them.
warnings.filterwarnings("ignore", category=RuntimeWarning, append=True)


def main() -> None:
    """Run the command line; Ctrl-C ends it quietly, even during import and while Python shuts down."""
    try:
        from lidar_emu.cli import main as command

        command()
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    main()

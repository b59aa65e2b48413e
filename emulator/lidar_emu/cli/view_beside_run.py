"""`lidar-emu view` as a child of a run: `python -m lidar_emu.cli.view_beside_run view FILE ...`.

It begins once the run writes a line to its standard input, and ends when the run closes it, or dies. What takes long
to import is there by then.
"""

from __future__ import annotations

import os
import signal
import sys
import threading

from lidar_emu.cli import main
from lidar_emu.cli.view import NICENESS
from lidar_emu.viewer import flight_parts as follow  # noqa: F401


def _end_with_the_run() -> None:
    sys.stdin.read()
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    os.nice(NICENESS)
    if sys.stdin.readline():
        threading.Thread(target=_end_with_the_run, daemon=True).start()
        main()

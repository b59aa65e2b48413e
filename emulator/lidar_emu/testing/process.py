"""`lidar-emu` that ends with the process which started it: standard input is a pipe that this process holds open."""

from __future__ import annotations

import os
import signal
import threading

from lidar_emu.__main__ import main

_INPUT = 0


def _end_with_input() -> None:
    while os.read(_INPUT, 1):
        continue
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    threading.Thread(target=_end_with_input, daemon=True).start()
    main()

"""The receiver's kernel, compiled in a second process while the first one compiles the kernels of ground and beams.

numba compiles with one processor. Two thirds of the time of a first start go into this one kernel. The types of its
arguments, which a compilation needs, are the same for every scenario: the second process finds them by measuring a shot
of a simple one, with all other kernels interpreted. If it fails, the kernel is compiled where it is called.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
from collections.abc import Callable

from lidar_emu.numerics.compilation import compile_beside, usable_cores
from lidar_emu.numerics.kernels import interpret_all_but

RECEIVER = "receiver.beam_measurement.measure_beams"
"""Full name of the kernel."""


def compile_receiver_beside() -> None:
    """Have the receiver's kernel compiled beside the first other one, where there are two processors."""
    if usable_cores() > 1 and sys.executable:
        compile_beside(RECEIVER, _started)


def _started() -> Callable[[], object]:
    quiet = subprocess.DEVNULL
    command = [sys.executable, "-P", "-m", __name__]
    try:
        process = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
    except OSError:  # too many processes, or too little memory
        return lambda: None

    def end() -> None:
        process.kill()
        process.wait()

    atexit.register(end)
    return process.wait


def measure_one_shot() -> None:
    """Measure a shot with the receiver's kernel compiled and all other kernels interpreted."""
    interpret_all_but(RECEIVER)
    # Imported after that: constants of kernels are made for interpreted ones.
    from lidar_emu.scenario.load import load, require_flight
    from lidar_emu.shots.flight_model import FlightModel

    model = FlightModel(require_flight(load("descent", site="flat")))
    model.measure(0, 1, model.initial_state)


if __name__ == "__main__":
    measure_one_shot()

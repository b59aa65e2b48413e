"""Where nothing can be compiled the receiver is slow, and the same."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.scenario.load import load

SETTINGS = {"duration_s": "0.1", "instrument.detection": "{peak: hann, combine: least_squares}"}
CODE = (
    "import lidar_emu; run = lidar_emu.simulate(lidar_emu.load('descent', %r));"
    "print(*run.range_m.ravel().tolist(), *run.snr_db.ravel().tolist())"
)


@pytest.mark.slow
def test_interpreted_kernels_measure_what_compiled_ones_do() -> None:
    reported = subprocess.run(
        [sys.executable, "-c", CODE % SETTINGS],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    compiled = simulate(load("descent", SETTINGS))
    interpreted = np.array(reported.stdout.split(), dtype=float).reshape(2, -1)
    np.testing.assert_allclose(interpreted[0], compiled.range_m.ravel(), rtol=1e-10)
    np.testing.assert_allclose(interpreted[1], compiled.snr_db.ravel(), rtol=1e-9)

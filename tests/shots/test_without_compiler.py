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


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["descent", "hazards"])
def test_single_shots_and_their_packets_without_a_compiler(scenario: str) -> None:
    """Kernels are plain functions then: nothing can be recorded, and packets are encoded field by field."""
    code = (
        "import lidar_emu; device = lidar_emu.EmbeddedDevice(%r, %r);"
        "packets = [p.payload for _ in range(6) for p in device.advance(device.next_ns)];"
        "print(*(packet.hex() for packet in packets))"
    )
    packets = [
        subprocess.run(
            [sys.executable, "-c", code % (scenario, {"duration_s": "0.3"})],
            env=os.environ | {"NUMBA_DISABLE_JIT": switch},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for switch in ("0", "1")
    ]
    assert len(packets[0]) > 1
    assert packets[0] == packets[1]

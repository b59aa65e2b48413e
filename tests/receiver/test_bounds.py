"""Kernels write within their arrays: interpreted, they raise where machine code would overwrite what is behind."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

SCENES = {
    "descent": {},
    "a thousand shots a second": {"timing.rate_hz": 1000, "duration_s": 5},
    "looks": {"instrument.detection.looks": 3},
    "nothing left out": {"left_out_share": 0.0},
    "a wide line": {"instrument.waveform.linewidth_hz": 2e5},
    "ripple": {"instrument.waveform.ripple_hz": 3e4},
    "leakage": {"instrument.optics.leakage_db": -20},
    "one beamlet": {"instrument.optics.beamlets": 1},
}
SCENARIOS = ["dust_storm", "dusty_landing", "powered_descent"]
CODE = """
import sys
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, initial_state, measure

model = build_model(load(sys.argv[1], eval(sys.argv[2])))
for first in (0, model.shot_count // 2, model.shot_count - 2):
    measured, _, _ = measure(model, first, 2, initial_state(model))
    print(measured.fired.sum())
"""


@pytest.mark.slow
@pytest.mark.parametrize("scene", [*SCENES, *SCENARIOS])
def test_indices_stay_within_the_arrays(scene: str) -> None:
    name, keys = ("descent", SCENES[scene]) if scene in SCENES else (scene, {})
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", CODE, name, repr(keys)],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split()) == 3

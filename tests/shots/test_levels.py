"""Levels of the receiver from the same echoes: the truth, and the spectra."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.scenario.load import load


def test_geometric_is_the_truth() -> None:
    run = simulate(load("descent.yaml", {"level": "geometric", "scanner.pattern.angle_deg": "60"}))
    seen = np.isfinite(run.true_range_m)
    near = seen & (run.true_range_m <= 12_000)
    np.testing.assert_array_equal(run.range_valid, near)
    np.testing.assert_array_equal(run.range_m[near], run.true_range_m[near])
    np.testing.assert_allclose(
        run.closing_speed_mps[near], run.true_closing_speed_mps[near], rtol=0, atol=1e-9
    )
    assert set(run.sigma_range_m[near]) == {0.0}


@pytest.mark.slow
def test_what_a_level_does_not_need_is_not_imported() -> None:
    code = (
        "import sys, lidar_emu; lidar_emu.simulate(lidar_emu.load('paper_fig4', {'level': %r, 'duration_s': '1'}));"
        "print(*[m for m in ('lidar_emu.receiver.receiver', 'lidar_emu.reference', 'matplotlib') if m in sys.modules])"
    )
    imported = {
        level: subprocess.run(
            [sys.executable, "-c", code % level], capture_output=True, text=True, check=True
        ).stdout.split()
        for level in ("geometric", "spectral")
    }
    assert imported == {"geometric": [], "spectral": ["lidar_emu.receiver.receiver"]}

"""Levels of the receiver from the same echoes: the truth, the error model, and the spectra."""

from __future__ import annotations

import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from lidar_emu.measurement import Measurement
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import simulate


@cache
def _flown(level: str, detection: str, rate_hz: int = 60) -> Measurement:
    settings = {"level": level, "instrument.detection": detection, "timing.rate_hz": str(rate_hz)}
    return simulate(load("descent.yaml", settings))


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


@pytest.mark.parametrize(
    "detection",
    ["{}", "{peak: hann, combine: least_squares}", "{peak: aboutanios_mulgrew, combine: least_squares}"],
)
def test_statistical_errors_and_dropouts_are_those_of_the_spectra(detection: str) -> None:
    """Over a whole descent on rough ground, where slopes spread the echo: a fifth apart at most."""
    spectral, statistical = (_flown(level, detection) for level in ("spectral", "statistical"))
    np.testing.assert_array_equal(spectral.true_range_m, statistical.true_range_m)
    for name, truth in (("range_m", "true_range_m"), ("closing_speed_mps", "true_closing_speed_mps")):
        errors = [
            (getattr(run, name) - getattr(run, truth))[run.range_valid] for run in (spectral, statistical)
        ]
        for quantile in (0.05, 0.25, 0.5, 0.75, 0.95):
            one, other = (np.quantile(e, quantile) for e in errors)
            assert abs(one - other) < 0.2 * np.subtract(*np.quantile(errors[0], [0.75, 0.25])), (
                name,
                quantile,
            )
    lost = [1 - run.range_valid.mean() for run in (spectral, statistical)]
    expected = np.mean(lost)
    assert abs(lost[0] - lost[1]) < 5 * np.sqrt(2 * expected / spectral.range_valid.size) + 0.1 * expected


@pytest.mark.slow
def test_what_a_level_does_not_need_is_not_imported() -> None:
    code = (
        "import sys, lidar_emu; lidar_emu.simulate(lidar_emu.load('paper_fig4', {'level': %r, 'duration_s': '1'}));"
        "print(*[m for m in ('lidar_emu.fmcw.receiver', 'lidar_emu.fmcw.waveform', 'matplotlib') if m in sys.modules])"
    )
    imported = {
        level: subprocess.run(
            [sys.executable, "-c", code % level], capture_output=True, text=True, check=True
        ).stdout.split()
        for level in ("geometric", "spectral")
    }
    assert imported == {"geometric": [], "spectral": ["lidar_emu.fmcw.receiver"]}

"""A small flight with every kind of gap, made by hand."""

import sys
from pathlib import Path

import numpy as np
import pytest

from lidar_emu.measurement import Measurement

# Scripts of tools/ import each other by name.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

SHOTS, BEAMS = 40, 4


@pytest.fixture
def flight():
    """Straight down over level ground; some beams without range, some without speed, some not fired."""
    rng = np.random.default_rng(5)
    shape = (SHOTS, BEAMS)
    shot = np.arange(SHOTS)
    altitude_m = np.linspace(1000.0, 200.0, SHOTS)[:, None]
    azimuth = np.radians(45 + 90 * np.arange(BEAMS))
    out_m = altitude_m * np.tan(np.radians(20))
    east_m, north_m = out_m * np.sin(azimuth), out_m * np.cos(azimuth)
    true_range_m = np.broadcast_to(altitude_m / np.cos(np.radians(20)), shape)
    true_speed_mps = np.broadcast_to(np.linspace(80.0, 20.0, SHOTS)[:, None], shape)
    fired = rng.random(shape) > 0.1
    range_valid = fired & (rng.random(shape) > 0.1)
    speed_valid = fired & (rng.random(shape) > 0.1)

    def noise(scale):
        return rng.normal(scale=scale, size=shape)

    points_m = np.stack([east_m, north_m, noise(0.1)], axis=-1)
    return Measurement.with_columns(
        shot,
        np.broadcast_to(shot[:, None] * 50_000_000 + 123_456, shape).copy(),
        shot * 50_000_000 + 2_900_000,
        fired=fired,
        beam_angle_deg=np.where(fired, 20.0, np.nan),
        range_m=np.where(range_valid, true_range_m + noise(0.1), np.nan),
        closing_speed_mps=np.where(speed_valid, true_speed_mps + noise(1e-3), np.nan),
        range_valid=range_valid,
        speed_valid=speed_valid,
        sign_resolved=speed_valid,
        reason=np.where(range_valid, 0, 3).astype(np.int8),
        segments=np.where(fired, 7, 0).astype(np.uint8),
        snr_db=np.where(fired, 20 + noise(1.0), np.nan),
        residual_mps=noise(1e-4),
        sigma_range_m=np.abs(noise(1e-2)),
        sigma_speed_mps=np.abs(noise(1e-3)),
        returns=fired.astype(np.uint8),
        true_range_m=true_range_m.copy(),
        true_closing_speed_mps=true_speed_mps.copy(),
        true_incidence_deg=np.full(shape, 20.0),
        point_site_m=np.where(range_valid[..., None], points_m, np.nan),
        position_site_m=np.concatenate([np.zeros((SHOTS, 2)), altitude_m], axis=1),
        velocity_site_mps=np.stack([np.zeros(SHOTS), np.zeros(SHOTS), -true_speed_mps[:, 0]], axis=1),
    )


@pytest.fixture
def bench():
    from lidar_emu.api import simulate
    from lidar_emu.scenario.load import load

    return simulate(load("bench.yaml", {"duration_s": "1"}))

"""Two surfaces in one footprint: both ranges, and none between them."""

from __future__ import annotations

import numpy as np
import pytest
from instruments import echoes

from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.scenario.instrument import Detection, Instrument

SHOTS = 3000
FLOOR_SHARE = 0.09
"""Power of the weakest group of a spectrum relative to the strongest bin."""


def seen(
    combine: str, step_m: float, share: float, pitches_per_s: float, slab_mps: float = 0.0
) -> tuple[float, float]:
    """Shares of shots with both ranges, and with a range that is farther than 1.5 bins from either surface."""
    instrument = Instrument(detection=Detection(combine=combine, peak="hann"))
    model = build_receiver(instrument)
    foot_m = 200.0 + np.random.default_rng(1).uniform(0.0, 0.343, (SHOTS, 1))
    range_m = np.stack([foot_m, foot_m + step_m], axis=-1)
    power_w = np.broadcast_to([share, 1.0 - share], range_m.shape) * 10**4 / model.snr_per_w
    beams = echoes(range_m, np.broadcast_to([20.0 + slab_mps, 20.0], range_m.shape), power_w)
    speckle = np.full((SHOTS, 1, 3), (pitches_per_s, 0.0, 0.0))
    found = receive(model, beams._replace(speckle_motion=speckle), np.arange(SHOTS), 1)
    near = abs(np.stack([found.range_m, found.second_range_m])[..., None] - range_m) < 1.5 * model.range_bin_m
    both = near.any(axis=0).all(axis=-1)
    ghost = np.isfinite([found.range_m, found.second_range_m]) & ~near.any(axis=-1)
    return float(both.mean()), float(ghost.any(axis=0).mean())


def both_in_a_chirp(share: float) -> float:
    """Neither of two exponential powers is below the floor of the other."""
    rest = 1.0 - share
    return share / (share + FLOOR_SHARE * rest) - share / (share + rest / FLOOR_SHARE)


@pytest.mark.parametrize("combine", ["least_squares", "chirp_minus_doppler"])
@pytest.mark.parametrize("step_m", [3.0, 5.0])
@pytest.mark.parametrize("share", [0.5, 0.3, 0.1, 0.03])
def test_a_still_step_gives_two_ranges(combine: str, step_m: float, share: float) -> None:
    both, ghosts = seen(combine, step_m, share, 0.0)
    assert both == pytest.approx(both_in_a_chirp(share), abs=0.04)
    assert ghosts <= 0.005


@pytest.mark.parametrize("share", [0.5, 0.3, 0.1, 0.03])
def test_chirps_with_speckle_of_their_own_are_paired(share: float) -> None:
    """At 40 m/s across the beam each chirp sees both or not by itself; the published detector needs one of them."""
    both, ghosts = seen("least_squares", 5.0, share, 2750.0)
    assert both == pytest.approx(both_in_a_chirp(share) ** 2, abs=0.04)
    assert ghosts <= 0.005
    both, ghosts = seen("chirp_minus_doppler", 5.0, share, 2750.0)
    assert both == pytest.approx(both_in_a_chirp(share), abs=0.04)
    assert ghosts <= 0.005


@pytest.mark.parametrize("combine", ["least_squares", "chirp_minus_doppler"])
@pytest.mark.parametrize("pitches_per_s", [0.0, 2750.0])
def test_a_surface_that_moves_gives_no_ghost(combine: str, pitches_per_s: float) -> None:
    both, ghosts = seen(combine, 5.0, 0.5, pitches_per_s, slab_mps=20.0)
    assert both > 0.55
    assert ghosts <= 0.02


@pytest.mark.parametrize("combine", ["least_squares", "chirp_minus_doppler"])
@pytest.mark.parametrize("distance_m", [500.0, 2000.0, 6000.0])
def test_the_pedestal_of_the_laser_is_no_surface(combine: str, distance_m: float) -> None:
    """One scatterer, of 30 dB: its phase noise surrounds it with a pedestal of up to a sixth of its power in a bin."""
    instrument = Instrument(detection=Detection(combine=combine, peak="hann"))
    model = build_receiver(instrument)
    range_m = distance_m + np.random.default_rng(1).uniform(0.0, 0.343, (SHOTS, 1, 1))
    beams = echoes(range_m, 20.0, 10**3 / model.snr_per_w)
    found = receive(model, beams, np.arange(SHOTS), 1)
    assert found.range_valid.mean() > 0.9
    assert np.isfinite(found.second_range_m).mean() <= 0.005

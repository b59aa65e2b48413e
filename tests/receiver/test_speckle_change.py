"""Speckle that changes within a record: tones against the process itself, and peaks against a Gaussian process."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from exchanged_speckle import WAIST_M, robust, scatter
from instruments import echoes
from speckle_process import speckle_at, speckle_model

import lidar_emu
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.skip_limits import negligible_bin2
from lidar_emu.receiver.speckle import (
    LINE_BIN2,
    level_for_travel,
    needed_level,
    speckle_work,
    tone_count,
    tone_offset_bin,
)
from lidar_emu.receiver.speckle_field import PITCH_W
from lidar_emu.scenario.instrument import Detection, Instrument
from lidar_emu.scenario.load import load

BEAMLETS, TIME_S = 61, 3e-4
MODEL = speckle_model()


@pytest.mark.parametrize("way", [0.01, 0.2, 0.5, 1.5, 3.5, 5.5, 8.0, 12.0, 20.0, 32.0, 48.0, 72.0])
def test_tones_follow_the_process(way: float) -> None:
    """In twelve shots, whose paths cross the corners anywhere: to 7 % of the change, exactly at the nodes up to a way
    of 8."""
    level = level_for_travel(way)
    assert level > 0
    assert level_for_travel(way * 1.001) > level or way in (0.01, 0.2, 72.0)
    work, count = speckle_work(64, level), tone_count(level)
    offset_bin = np.array([tone_offset_bin(level, tone) for tone in range(count)])
    nodes = work.node.shape[1] if way > 8.0 else count
    at = np.append(work.node[level, :nodes], np.linspace(-0.45, 0.45, 61))
    light = echoes(np.full((12, 1, BEAMLETS), 500.0), 10.0, travel_per_s=way / MODEL.record_time_s)
    weight = speckle_at(MODEL, light, np.array([TIME_S]), np.arange(12), level=level)[:, 0, 0, :count]
    exact = speckle_at(MODEL, light, TIME_S + MODEL.record_time_s * at, np.arange(12))[:, 0, :, 0]
    tones = np.exp(2j * np.pi * np.outer(at, offset_bin)) @ weight
    if nodes == count:
        # Weights of tones close together are large, and rounded to single precision.
        largest = np.abs(weight).max()
        np.testing.assert_allclose(tones[:, :nodes], exact[:, :nodes], rtol=0, atol=1e-5 * largest)
    between, error = exact[:, nodes:], (tones - exact)[:, nodes:]
    change = between - between.mean(axis=1, keepdims=True)
    assert np.sqrt(np.mean(abs(error) ** 2) / np.mean(abs(change) ** 2)) < 0.07


def test_line_has_the_width_of_the_exchange() -> None:
    """(V⊥ T/(π √2 w))², V⊥ T being the way: the curvature of exp(-D²/w²)."""
    way_w = PITCH_W
    assert pytest.approx((way_w / (np.pi * np.sqrt(2))) ** 2, rel=1e-12) == LINE_BIN2


@pytest.mark.parametrize(("peak", "power_w"), [("bin", 1e-12), ("hann", 1e-12), ("hann", 1e-15)])
def test_change_is_left_out_by_its_share_of_the_variance(peak: str, power_w: float) -> None:
    """A third of what makes sigma 5 % larger."""
    share = (1.05**2 - 1) / 3
    model = build_receiver(Instrument(detection=Detection(peak=peak)))
    efficiency = 3.24 if peak == "hann" else 1.0
    variance = efficiency * 6 / (4 * np.pi**2 * model.snr_per_w * power_w) + (1 / 12 if peak == "bin" else 0)
    way = np.sqrt(share * variance / (0.5 * LINE_BIN2))
    for factor, on in ((0.99, False), (1.01, True)):
        travel_per_s = factor * way / model.record_time_s
        assert (needed_level(model, travel_per_s, negligible_bin2(model, power_w)) > 0) == on
        exact = build_receiver(Instrument(detection=Detection(peak=peak)), left_out_share=0.0)
        assert needed_level(exact, travel_per_s, negligible_bin2(exact, power_w)) > 0
    assert needed_level(exact, 0.0, 0.0) == 0


def _glide(speed_mps: float, shots: int, **more: Any) -> dict[str, Any]:
    """One beam straight down over level ground from 300 m, with sub-bin peaks and a flat receiver."""
    half_m = 0.51 * speed_mps * float(np.sin(np.radians(0.2))) * 0.01 * shots
    waypoints = [{"altitude_m": 300 + side * half_m, "speed_mps": speed_mps} for side in (1, -1)]
    return {
        "timing.rate_hz": 100,
        "duration_s": 0.01 * shots,
        "instrument": {
            "base": "ndl_fine",
            "detection": {"peak": "hann"},
            "waveform": {"linewidth_hz": 0},
            "receiver": {"adc": None, "bandwidth_hz": None, "ac_coupling_hz": 0},
        },
        "site": {"base": "flat", "surface": {"reflectance": 0.18, "lommel_seeliger_share": 1}},
        "scanner": {"pattern": {"kind": "directions", "beams": [[0, 0]]}},
        "trajectory": {"kind": "profile", "path_angle_deg": 0.2, "waypoints": waypoints},
    } | more


def _assert_scatter(settings: dict[str, Any], speed_mps: float) -> None:
    """Errors scatter as those of a beam that moves across at this speed."""
    scenario = load("descent", {key: str(value).replace("None", "null") for key, value in settings.items()})
    run = lidar_emu.simulate(scenario)
    valid = run.range_valid
    assert valid.mean() > 0.95
    errors = run.range_m - run.true_range_m, run.closing_speed_mps - run.true_closing_speed_mps
    # The peak over the mean of a line of several bins; exact for the weights of noise, which does not matter here.
    snr = float(np.mean(10 ** (run.snr_db[valid] / 10)))
    # Three Monte Carlo errors of either, 2.3 and 1.4 %, and five per cent.
    found = [robust(error[valid]) for error in errors]
    np.testing.assert_allclose(found, scatter(speed_mps, snr), rtol=0.05 + 3 * 0.027)


@pytest.mark.slow
@pytest.mark.parametrize(("beamlets", "speed_mps"), [(1, 20.0), (1, 40.0), (19, 40.0), (1, 100.0)])
def test_peaks_scatter_as_of_a_gaussian_process(beamlets: int, speed_mps: float) -> None:
    settings = _glide(speed_mps, 3000)
    settings["instrument"]["optics"] = {"beamlets": beamlets}
    _assert_scatter(settings, speed_mps)


@pytest.mark.slow
@pytest.mark.parametrize(("spin_radps", "beamlets"), [(3.0, 1), (3.0, 19), (10.0, 1), (10.0, 19)])
def test_peaks_of_a_beam_that_spins_scatter_as_of_a_gaussian_process(
    spin_radps: float, beamlets: int
) -> None:
    """At 7.5 degrees, 300 m: exp(-(π w0 u' t/λ)²) is the correlation of a beam that moves at zR u' = π w0² u'/λ."""
    settings = _glide(0.5, 3000, **{"timing.rate_hz": 1000, "duration_s": 3})
    settings["scanner"] = {"pattern": {"kind": "directions", "beams": [[7.5, 0]]}}
    settings["trajectory"] = {
        "kind": "profile",
        "waypoints": [{"altitude_m": 300 + side, "speed_mps": 0.5} for side in (1, -1)],
        "attitude": {"body_rate_radps": [0, 0, spin_radps]},
    }
    settings["instrument"]["optics"] = {"beamlets": beamlets}
    turn_radps = spin_radps * float(np.sin(np.radians(7.5)))
    _assert_scatter(settings, np.pi * WAIST_M**2 / 1550e-9 * turn_radps)

"""Leakage, samples that clip, and spectra, at level reference."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu import simulate
from lidar_emu.api import shot_spectra
from lidar_emu.beams.flight import Flight
from lidar_emu.receiver.returns import FalseTarget, Reason
from lidar_emu.reference.level import ScattererLevel
from lidar_emu.scenario.load import load, require_flight
from lidar_emu.shots.model import build_model

REFERENCE = {"level": "reference"}
FULL_RATE = {"level": "reference", "reference_samples": "full_rate"}


def glide(shots: int, beams: str, **more: str) -> dict[str, str]:
    """Beams from 100 m over the flat site, pitched up by 20°."""
    return {
        "timing.rate_hz": "100",
        "duration_s": str(0.01 * shots),
        "site": "flat",
        "instrument": "{base: ndl_fine, waveform: {linewidth_hz: 0}}",
        "scanner": f"{{pattern: {{kind: directions, beams: {beams}}}}}",
        "mounting": "{pitch_deg: 20}",
        "trajectory": "{kind: profile, path_angle_deg: 30, waypoints: [{altitude_m: 100, speed_mps: 10}, "
        "{altitude_m: 98, speed_mps: 10}]}",
    } | more


def leaking(shots: int) -> dict[str, str]:
    """A beam to the ground, and one to the sky that receives a hundredth of its light."""
    return glide(shots, "[[0, 0], [89, 0]]") | {
        "instrument.optics.leakage_db": "-20",
        "instrument.optics.laser_power_w": "20",
    }


def test_a_beam_that_looks_at_the_sky_measures_the_other_beam() -> None:
    run = simulate("descent", leaking(16) | REFERENCE)
    assert run.range_valid.mean(axis=0) == pytest.approx([1.0, 1.0], abs=0.13)
    seen = run.range_valid[:, 1]
    np.testing.assert_allclose(run.range_m[seen, 1], run.range_m[seen, 0], atol=0.3)
    strong, leaked = np.mean(10.0 ** (0.1 * run.snr_db[seen]), axis=0)
    assert 10.0 * np.log10(strong / leaked) == pytest.approx(20.0, abs=0.5)
    assert (run.true_peak_source[seen, 1] == FalseTarget.LEAKAGE).all()
    assert (run.true_peak_source[:, 0] == FalseTarget.NONE).all()


@pytest.mark.slow
def test_leaked_light_is_the_same_from_all_samples() -> None:
    """The second of the four shots fades for both: it has 12 dB less than the others."""
    narrow, whole = (simulate("descent", leaking(4) | level) for level in (REFERENCE, FULL_RATE))
    np.testing.assert_array_equal(whole.reason, narrow.reason)
    assert whole.range_valid.sum() == 7
    np.testing.assert_allclose(whole.snr_db, narrow.snr_db, atol=1.0)


def test_the_plan_names_the_light_of_other_beams() -> None:
    for leakage_db, beams, computed in (("-60", "[[0, 0], [30, 0]]", True), ("-60", "[[0, 0]]", False)):
        settings = glide(1, beams) | REFERENCE | {"instrument.optics.leakage_db": leakage_db}
        decisions = build_model(load("descent", settings)).plan.decisions
        assert [row.computed for row in decisions if row.stage == "leakage between beams"] == [computed]


@pytest.mark.parametrize("fires", [True, False])
def test_a_beam_that_does_not_fire_leaks_nothing(fires: bool) -> None:
    settings = glide(4, "[[0, 0], [89, 0]]") | REFERENCE | {"instrument.optics.leakage_db": "-10"}
    scenario = require_flight(load("descent", settings))
    flight = Flight(scenario)
    pointing, _ = flight.point(np.arange(4), flight.scanner.initial)
    pointing.fired[:, 0] = fires
    returns = ScattererLevel(scenario, flight).measure(pointing, flight.cast(pointing), np.arange(4))
    assert returns.range_valid[:, 1].any() == fires
    if not fires:
        assert set(returns.reason[:, 1]) == {Reason.NO_SURFACE}


@pytest.mark.slow
def test_samples_clip() -> None:
    """A back-reflection far above full scale: a tone of the amplitude A spends 1 - (2/pi) arcsin(F/A) of it clipped."""
    settings = glide(3, "[[0, 0]]") | {"instrument.optics.back_reflection_db": "-20"}
    spectra = shot_spectra("descent", 1, settings | FULL_RATE, seed=2)[0]
    shares, fullest = [], []
    for spectrum in spectra.values():
        assert spectrum.samples is not None
        fullest.append(np.abs(spectrum.samples).max())
        shares.append(np.mean(np.abs(spectrum.samples) >= 0.999 * fullest[-1]))
    assert fullest[0] == fullest[2] == pytest.approx(7165.763, rel=1e-6)
    assert shares == pytest.approx([0.992, 0.0, 0.992], abs=1e-3)
    assert fullest[1] < 0.3 * fullest[0]


def test_narrowband_has_bins_and_no_samples() -> None:
    one = shot_spectra("descent", 0, glide(1, "[[0, 0]]") | REFERENCE)[0]["down"]
    assert one.samples is None
    assert one.bins is not None
    assert one.bins.shape == one.power.shape == one.frequency_hz.shape == (2**16 + 1,)

"""Leakage between beams: an echo of another beam, at level spectral and from samples."""

from __future__ import annotations

import re

import numpy as np
import pytest
from beamlet_samples import measure_echoes
from instruments import echoes, plain

from lidar_emu.plan import Decision
from lidar_emu.receiver.false_targets import false_targets
from lidar_emu.receiver.received_echoes import leaked
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import FalseTarget
from lidar_emu.scenario.instrument import Optics
from lidar_emu.scenario.load import load
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model, measure_whole

SHORT = {"fft_length": 512, "sample_rate_hz": 600e6 / 256}
INSTRUMENT = plain(SHORT, peak="hann").model_copy(update={"optics": Optics(leakage_db=-30.0)})
MODEL = build_receiver(INSTRUMENT)


@pytest.mark.parametrize("from_samples", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_beam_without_an_echo_measures_the_other_beam(from_samples: bool) -> None:
    shots = 300
    range_m, power_w = np.empty((shots, 2, 1)), np.zeros((shots, 2, 1))
    range_m[:, 0], range_m[:, 1] = 30.0, 60.0
    power_w[:, 1] = 1e-9
    alone = echoes(range_m, 0.2, power_w)
    both = leaked(alone, -30.0)
    shot = np.arange(shots)
    returns = (
        measure_echoes(INSTRUMENT, MODEL, both, shot, 2) if from_samples else receive(MODEL, both, shot, 1)
    )
    strong_db, leaked_db = (
        10.0 * np.log10(np.nanmean(10.0 ** (returns.snr_db[:, b] / 10.0))) for b in (1, 0)
    )
    assert strong_db - leaked_db == pytest.approx(30.0, abs=1.5)
    assert returns.range_valid.mean(axis=0) == pytest.approx(1.0, abs=0.12)
    assert np.nanmedian(returns.range_m, axis=0) == pytest.approx(60.0, abs=0.05)
    found = false_targets(
        MODEL, returns.segment_peak_hz, range_m[..., 0], np.full((shots, 2), 0.2), leakage=True
    )
    assert (found[returns.range_valid[:, 0], 0] == FalseTarget.LEAKAGE).all()
    assert (found[returns.range_valid[:, 1], 1] == FalseTarget.NONE).all()
    # Speckle of its own.
    assert abs(np.corrcoef(np.nan_to_num(returns.snr_db).T)[0, 1]) < 0.25


def test_a_beam_that_does_not_fire_leaks_nothing() -> None:
    given = echoes([30.0, 70.0, 50.0], 0.2, 1e-9)
    given.fired[0, 1] = False
    both = leaked(given, -20.0)
    assert both.range_m[0].tolist() == [[30.0, 70.0, 50.0], [70.0, 30.0, 50.0], [50.0, 30.0, 70.0]]
    np.testing.assert_allclose(both.power_w[0], [[1e-9, 0, 1e-11], [0, 1e-11, 1e-11], [1e-9, 1e-11, 0]])


def _planned(leakage_db: float | None, instrument: str, **keys: str) -> tuple[Decision, FlightModel]:
    settings = {
        "instrument": instrument,
        "instrument.optics.leakage_db": "null" if leakage_db is None else str(leakage_db),
        "duration_s": "2",
    }
    model = build_model(load("descent.yaml", settings | keys))
    (row,) = (each for each in model.plan.decisions if each.stage == "leakage between beams")
    return row, model


@pytest.mark.slow
@pytest.mark.parametrize(("instrument", "limit"), [("ndl_fine", 0.0175), ("ndl_four_beam", 0.1)])
def test_the_plan_leaves_out_what_changes_nothing(instrument: str, limit: float) -> None:
    """Sub-bin peaks: the shift by other beams, 0.7 bin per amplitude, against a quarter of the growth, by 5 % of sigma,
    of the variance by noise, 1.1 · 0.152/snr: both fall with the beam's own power. Quantised ones: the noise."""
    row, _ = _planned(-60.0, instrument)
    found = re.search(r"(-?\d+) dB of the noise", row.reason)
    assert found
    limit_db = -60.0 + 10.0 * np.log10(limit) - float(found[1])
    (below, left_out), (above, _), (none, without) = (
        _planned(leakage_db, instrument) for leakage_db in (limit_db - 1.0, limit_db + 1.0, None)
    )
    assert (below.computed, above.computed, none.computed) == (False, True, False)
    bare, kept_out = measure_whole(without), measure_whole(left_out)
    np.testing.assert_array_equal(bare.range_m, kept_out.range_m)
    _, exact = _planned(limit_db - 1.0, instrument, left_out_share="0")
    _, exact_without = _planned(None, instrument, left_out_share="0")
    whole, reference = measure_whole(exact), measure_whole(exact_without)
    both = whole.range_valid & reference.range_valid
    assert both.mean() > 0.95 * reference.range_valid.mean()
    assert (whole.snr_db != reference.snr_db)[both].any()
    if instrument == "ndl_fine":
        moved = (whole.range_m - reference.range_m)[both] / reference.sigma_range_m[both]
        assert np.mean(moved**2) < (1.05**2 - 1.0) / 4.0
    else:
        errors = ((each.range_m - each.true_range_m)[both] for each in (whole, reference))
        with_it, without_it = (np.sqrt(np.mean(each**2)) for each in errors)
        assert with_it < 1.05 * without_it

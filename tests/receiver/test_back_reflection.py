"""Back-reflection of the optics: its line against samples, what locks onto it, and what the digitiser loses."""

from __future__ import annotations

import numpy as np
import pytest
from beamlet_samples import measure_echoes
from instruments import PLAIN, PLAIN_RECEIVER, echoes, plain

from lidar_emu.errors import InputError
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.receiver.back_reflection import reflection_power
from lidar_emu.receiver.false_targets import false_targets
from lidar_emu.receiver.range_speed_estimation import DOWN, UP
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import FalseTarget, Reason, Returns
from lidar_emu.scenario.instrument import Adc, Instrument, Optics, Receiver
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_whole

SHORT = {"fft_length": 512, "sample_rate_hz": 600e6 / 256}
RANGE_M, SPEED_MPS, ECHO_W = 30.013, 0.2003, 1e-11


RECEIVER = PLAIN_RECEIVER.model_copy(update={"ac_coupling_hz": 10e3})


def _instrument(level_db: float | None, receiver: Receiver = RECEIVER, **detection: object) -> Instrument:
    optics = Optics(speckle=False, back_reflection_db=level_db, back_reflection_range_m=3.0)
    short = plain(SHORT, **({"peak": "hann"} | detection))
    return short.model_copy(update={"optics": optics, "receiver": receiver})


def _both(instrument: Instrument, shots: int, range_m: float = RANGE_M) -> tuple[Returns, Returns]:
    """Spectral level and level waveform."""
    model = build_receiver(instrument)
    beams = echoes(np.full((shots, 1, 1), range_m), SPEED_MPS, ECHO_W if np.isfinite(range_m) else 0.0)
    return (
        receive(model, beams, np.arange(shots), 1),
        measure_echoes(instrument, model, beams, np.arange(shots), 2),
    )


def _beat_hz(range_m: float) -> float:
    return 2.0 * PLAIN.waveform.chirp_slope_hz_per_s * range_m / 299_792_458.0


@pytest.mark.slow
def test_chirps_lock_onto_a_strong_reflection() -> None:
    model = build_receiver(_instrument(-90.0))
    for returns in _both(_instrument(-90.0), 40):
        peak_hz = returns.segment_peak_hz[:, 0]
        # Its image on the other side of 0 moves the peak.
        np.testing.assert_allclose(peak_hz[:, [0, 2]], _beat_hz(3.0), atol=0.2 * PLAIN.waveform.bin_width_hz)
        np.testing.assert_allclose(peak_hz[:, 1], 2.0 * SPEED_MPS / 1.55e-6, rtol=1e-2)
        truth = np.full((40, 1), RANGE_M), np.full((40, 1), SPEED_MPS)
        assert (false_targets(model, returns.segment_peak_hz, *truth) == FalseTarget.BACK_REFLECTION).all()
    weak = receive(build_receiver(_instrument(-140.0)), echoes(RANGE_M, SPEED_MPS), np.arange(1), 1)
    found = false_targets(model, weak.segment_peak_hz, *(values[:1] for values in truth))
    assert weak.range_valid[0, 0]
    assert (found == FalseTarget.NONE).all()


def test_its_power_is_that_of_an_echo() -> None:
    echo = receive(build_receiver(_instrument(None)), echoes(3.0, 0.0, 1e-9), np.arange(1), 1)
    for returns in _both(_instrument(-90.0), 40, range_m=np.nan):
        assert (returns.segments == UP | DOWN).all()
        assert np.median(returns.snr_db) == pytest.approx(echo.snr_db[0, 0], abs=0.5)
        assert (returns.reason == Reason.NO_SURFACE).all()


@pytest.mark.slow
def test_a_mask_leaves_the_echo_as_it_is() -> None:
    masked = _instrument(-90.0, window="hamming", lowest_beat_hz=80e3)
    undisturbed = _instrument(None)
    for with_mask, without in zip(_both(masked, 200), _both(undisturbed, 200), strict=True):
        assert with_mask.range_valid.mean() == pytest.approx(without.range_valid.mean(), abs=0.02)
        # What remains are sidelobes of the Hann window, 83 bins away.
        np.testing.assert_allclose(np.nanmedian(with_mask.range_m), np.nanmedian(without.range_m), atol=0.002)


def test_the_digitiser_loses_what_the_reflection_clips() -> None:
    """Beside a line of 1.3 times the largest amplitude an echo keeps the share of time without clipping, 0.56; 0.72 by
    Gaussian statistics."""
    free = RECEIVER.model_copy(update={"adc": Adc(effective_bits=24.0, full_scale_v=10.0)})
    model = build_receiver(_instrument(-90.0, free))
    ratio = model.response.full_scale / np.sqrt(interpreted(reflection_power)(model, 0))
    clipping = free.model_copy(update={"adc": Adc(effective_bits=24.0, full_scale_v=10.0 / 1.3 / ratio)})
    # Stronger than the harmonics of the line, which are noise at level spectral.
    echo_w, beams = 1.5e-10, np.full((60, 1, 1), RANGE_M)
    snr_db = []
    for receiver in (free, clipping):
        instrument = _instrument(-90.0, receiver, lowest_beat_hz=80e3)
        arguments = build_receiver(instrument), echoes(beams, SPEED_MPS, echo_w), np.arange(60)
        returns = receive(*arguments, 1), measure_echoes(instrument, *arguments, 2)
        snr_db.append([10.0 * np.log10(np.median(10.0 ** (each.snr_db / 10.0))) for each in returns])
    lost_db = np.subtract(*snr_db)
    assert (lost_db > 1.5).all()
    assert abs(lost_db[1] - lost_db[0]) < 5.0


def test_the_truth_of_a_flight_names_it_and_the_plan_has_its_line() -> None:
    key, mask = "instrument.optics.back_reflection_db", "instrument.detection.lowest_beat_hz"
    keys = {key: "-60", "duration_s": "0.5"}
    locked, masked = (build_model(load("descent.yaml", keys | more)) for more in ({}, {mask: "200e3"}))
    (row,) = (each for each in locked.plan.decisions if each.stage == "back-reflection")
    assert row.computed
    assert "13.3 kHz" in row.reason
    assert "below lowest_beat_hz" in next(
        each.reason for each in masked.plan.decisions if each.stage == "back-reflection"
    )
    assert (measure_whole(locked).true_peak_source == FalseTarget.BACK_REFLECTION).all()
    assert (measure_whole(masked).true_peak_source == FalseTarget.NONE).all()


@pytest.mark.parametrize(("beat_hz", "fits"), [("2.9e8", True), ("3.0e8", False), ("1e12", False)])
def test_a_mask_leaves_beats_below_half_the_sample_rate(beat_hz: str, fits: bool) -> None:
    settings = {"instrument.detection.lowest_beat_hz": beat_hz}
    if fits:
        load("descent", settings)
        return
    with pytest.raises(InputError, match=r"below 3e\+08, half the sample rate"):
        load("descent", settings)

"""Spectra of a shot against the beats of its true range and speed; detectors of one's own against ours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lidar_emu import InputError, Measurement, SegmentSpectrum, shot_spectra, simulate

C_MPS = 299_792_458.0
FLIGHT: dict[str, Any] = {
    "site": "flat",
    "duration_s": 0.3,
    "instrument.optics.beamlets": 1,
    "instrument.detection.peak": "bin",
}
STEADY = FLIGHT | {"instrument.optics.speckle": False}
LEVELS: list[dict[str, Any]] = [
    STEADY | {"level": "spectral"},
    FLIGHT | {"level": "reference"},
]
FULL_RATE = FLIGHT | {"level": "reference", "reference_samples": "full_rate"}
NAMES = ["spectral", "reference"]
# The kernels of custom detectors at level spectral take 20 s and more to compile, and nothing else uses them.
BY_LEVEL = [pytest.param(LEVELS[0], marks=pytest.mark.slow), *LEVELS[1:]]


def strongest_bin(spectrum: SegmentSpectrum) -> list[float]:
    """The quantised peak of the published detector, written anew."""
    if not spectrum.power.size:
        return []
    best = int(np.argmax(spectrum.power))
    return [spectrum.frequency_hz[best]] if spectrum.power[best] > spectrum.threshold[best] else []


def beats_hz(run: Measurement, row: int, beam: int) -> dict[str, float]:
    """Beats of the truth: 2 S R / c and 2 v / lambda, of the shipped instrument."""
    beat = 2 * 2e12 * run.true_range_m[row, beam] / C_MPS
    doppler = 2 * run.true_closing_speed_mps[row, beam] / 1550e-9
    return {"up": abs(beat - doppler), "constant": abs(doppler), "down": beat + doppler}


@pytest.mark.parametrize(
    "flight", [*BY_LEVEL, pytest.param(FULL_RATE, marks=pytest.mark.slow)], ids=[*NAMES, "full_rate"]
)
def test_peaks_are_at_the_beats_of_the_truth(flight: dict[str, Any]) -> None:
    run = simulate("descent", FLIGHT, level="geometric")
    spectra = shot_spectra("descent", 3, flight)
    assert list(spectra) == [0, 1, 2, 3]
    bin_hz = 600e6 / 2**17
    for beam, segments in spectra.items():
        for name, expected_hz in beats_hz(run, 3, beam).items():
            one = segments[name]
            assert (one.shot, one.beam, one.segment) == (3, beam, name)
            peak_hz = one.frequency_hz[np.argmax(one.power)]
            # Range changes between the segments by v T, some bins at this speed.
            assert peak_hz == pytest.approx(expected_hz, abs=4 * bin_hz), (beam, name)
            if flight["level"] != "spectral":
                assert one.bins is not None
                if "reference_samples" in flight:
                    assert one.samples is not None
                    assert one.samples.shape == (2**17,)
                np.testing.assert_allclose(np.abs(one.bins[1:-1]) ** 2, one.power[1:-1], rtol=1e-9)
                # Away from the line there is the noise that the detector assumes.
                away = np.abs(one.frequency_hz - peak_hz) > 1e6
                assert one.power[away].mean() == pytest.approx(one.noise_power[away].mean(), rel=0.05)
            else:
                assert one.samples is None
                assert one.frequency_hz.size < 1000


@pytest.mark.parametrize("flight", BY_LEVEL, ids=NAMES)
def test_our_detector_written_anew_measures_the_same(flight: dict[str, Any]) -> None:
    ours = simulate("descent", flight)
    own = simulate("descent", flight, detector=strongest_bin)
    assert ours.range_valid.mean() > 0.9
    both = ours.range_valid & own.range_valid
    assert both.sum() >= ours.range_valid.sum() - 1
    for name in ("range_m", "closing_speed_mps", "residual_mps"):
        np.testing.assert_allclose(
            getattr(own, name)[both], getattr(ours, name)[both], rtol=1e-12, atol=1e-12
        )
    np.testing.assert_allclose(own.snr_db[both], ours.snr_db[both], atol=0.05)
    np.testing.assert_array_equal(own.true_range_m, ours.true_range_m)


def centroid(spectrum: SegmentSpectrum) -> list[float]:
    """Centre of gravity of the powers around the highest bin."""
    found = strongest_bin(spectrum)
    if not found:
        return found
    near = np.abs(spectrum.frequency_hz - found[0]) < 2.5 * 600e6 / 2**17
    return [float(np.average(spectrum.frequency_hz[near], weights=spectrum.power[near]))]


@pytest.mark.slow
def test_a_centroid_is_better_than_the_highest_bin() -> None:
    """With a Hann window, whose line is four bins wide, the centroid is unbiased to a fraction of a bin."""
    flight = STEADY | {
        "duration_s": 2,
        "instrument.detection.window": "hann",
        "instrument.optics.laser_power_w": 5,
    }
    errors_mps = []
    for detector in (strongest_bin, centroid):
        run = simulate("descent", flight, level="spectral", detector=detector)
        errors_mps.append(np.nanstd(run.closing_speed_mps - run.true_closing_speed_mps))
    assert errors_mps[1] < 0.6 * errors_mps[0]


@pytest.mark.slow
def test_nothing_detected_is_below_threshold() -> None:
    for flight in LEVELS:
        run = simulate("descent", flight, duration_s=0.1, detector=lambda _: [])
        assert set(run.reason_name.ravel()) == {"BELOW_THRESHOLD"}


@pytest.mark.parametrize(
    ("changes", "detector", "line"),
    [
        ({}, lambda _: "here", "detector: shot 0 beam 0: must be frequencies from 0 to 3e+08 Hz"),
        ({}, lambda _: [-1.0], "detector: shot 0 beam 0: must be frequencies from 0 to 3e+08 Hz"),
        ({}, lambda _: [float("nan")], "detector: shot 0 beam 0: must be frequencies from 0 to 3e+08 Hz"),
        ({"level": "geometric"}, strongest_bin, "descent: level: must be spectral or reference"),
        (
            {"faults": [{"kind": "missing_segment", "segments": ["up"]}]},
            strongest_bin,
            "descent: faults: missing_segment with a custom detector; leave out the faults of the receiver",
        ),
    ],
)
def test_refusals_are_one_line(changes: dict[str, Any], detector: Any, line: str) -> None:
    with pytest.raises(InputError) as refused:
        simulate("descent", FLIGHT | changes, detector=detector)
    assert str(refused.value).startswith(line)
    with pytest.raises(
        InputError, match=r"shot_spectra: shot: must be a whole number from 0 to \d+ \(got 999\)"
    ):
        shot_spectra("descent", 999, FLIGHT)

"""docs/physics.md: its keys, units and defaults are the schema's, its functions exist, and its check values follow from
the code and from a second form."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from functools import reduce
from math import log, log10, pi, sqrt
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from scipy.integrate import quad

from lidar_emu.beams.footprint import beam_radius_m, rayleigh_range_m
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.receiver.beat_tones import signed_bin
from lidar_emu.receiver.laser_phase_noise import line_share, line_variance
from lidar_emu.receiver.link_budget import coherent_power_w, noise_over_shot, snr_per_w, sunlight_over_shot
from lidar_emu.receiver.motion_smear import smear_bins
from lidar_emu.receiver.peak_interpolation import CRAMER_RAO_BIN2, EFFICIENCY, PEAK_METHODS
from lidar_emu.receiver.range_speed_estimation import BEAT_WEIGHTS, COMBINE_METHODS
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS as C
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.scanner import Mounting, Scanner
from lidar_emu.scenario.site import Plane, Site, Surface

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "physics.md").read_text(encoding="utf-8")
PARTS: dict[str, type[BaseModel]] = {
    "instrument": Instrument,
    "site": Site,
    "scanner": Scanner,
    "mounting": Mounting,
}
UNITS = {
    "_per_m_sr": "1/(m sr)",
    "_per_m": "1/m",
    "_w_per_m2_um": "W/(m² µm)",
    "_hz_per_s": "Hz/s",
    "_db_per_hz": "dB/Hz",
    "_a_per_w": "A/W",
    "_mps": "m/s",
    "_mrad": "mrad",
    "_rad": "rad",
    "_ohm": "Ω",
    "_hz2": "Hz²",
    "_hz": "Hz",
    "_db": "dB",
    "_m": "m",
    "_s": "s",
    "_w": "W",
    "_k": "K",
    "_a": "A",
    "_v": "V",
}
NAMED_IN_TEXT = {"instrument.name"}

INSTRUMENT = Instrument()
WAVE = INSTRUMENT.waveform
LAMBDA, SLOPE, RECORD_S, BIN_HZ = (
    WAVE.wavelength_m,
    WAVE.chirp_slope_hz_per_s,
    WAVE.record_time_s,
    WAVE.bin_width_hz,
)
CHARGE_C, BOLTZMANN_J_PER_K = 1.602176634e-19, 1.380649e-23


def rows(heading: str) -> list[list[str]]:
    """Cells of the first table below a heading."""
    section = PAGE.split(f"\n{heading}\n", 1)[1]
    table = re.search(r"(?:^\|.*\n)+", section, re.MULTILINE)
    assert table, heading
    lines = table[0].splitlines()[2:]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in models(argument)]


def field(key: str) -> FieldInfo:
    first, *names = key.split(".")
    found, model = None, PARTS[first]
    for name in names:
        found = model.model_fields[name]
        model = next(iter(models(found.annotation)), model)
    assert found is not None
    return found


def leaves(prefix: str, model: type[BaseModel]) -> Iterator[str]:
    for name, info in model.model_fields.items():
        below = models(info.annotation)
        if below:
            yield from leaves(f"{prefix}.{name}", below[0])
        else:
            yield f"{prefix}.{name}"


def value_of(default: Any) -> str:
    if default is PydanticUndefined:
        return "required"
    if isinstance(default, bool):
        return "on" if default else "off"
    if isinstance(default, tuple):
        return ", ".join(f"{each:g}" for each in default)
    return "none" if default in ([], None) else str(default)


@pytest.mark.parametrize("row", rows("## Symbols and keys"), ids=lambda row: row[2])
def test_keys_have_the_unit_and_default_of_the_schema(row: list[str]) -> None:
    _, _, key, unit, printed = row
    key = key.strip("`")
    default = value_of(field(key).default)
    if re.fullmatch(r"-?[\d.]+(e-?\d+)?", printed):
        assert float(printed) == float(default)
    else:
        assert printed == default
    assert unit == next((unit for suffix, unit in UNITS.items() if key.endswith(suffix)), "1")


def test_every_key_of_an_instrument_has_a_symbol() -> None:
    named = {row[2].strip("`") for row in rows("## Symbols and keys")} | NAMED_IN_TEXT
    assert set(leaves("instrument", Instrument)) <= named


def test_every_function_exists() -> None:
    keys = {row[2].strip("`") for row in rows("## Symbols and keys")}
    names = set(re.findall(r"`((?:beams|plan|receiver|reference|scenario)\.[\w.]+)`", PAGE)) - keys
    assert len(names) > 40
    for name in names:
        parts = name.split(".")
        for length in range(len(parts), 0, -1):
            try:
                module = importlib.import_module(".".join(["lidar_emu", *parts[:length]]))
            except ModuleNotFoundError:
                continue
            reduce(getattr, parts[length:], module)
            break
        else:
            raise AssertionError(name)


def bright() -> Site:
    return Site(
        ground=Plane(kind="plane"),
        surface=Surface(reflectance=0.18, lommel_seeliger_share=1.0),
        sunlight_w_per_m2_um=270.0,
    )


def echo_by_quadrature_w(range_m: float) -> float:
    """λ² ∫ L_s I dA over the footprint, the field of the mode from the diffraction angle."""
    optics = INSTRUMENT.optics
    width_m = sqrt(optics.waist_radius_m**2 + (LAMBDA * range_m / (pi * optics.waist_radius_m)) ** 2)

    def mode(r: float) -> float:
        return 2.0 / (pi * width_m**2) * np.exp(-2.0 * (r / width_m) ** 2)

    overlap, _ = quad(lambda r: mode(r) ** 2 * 2.0 * pi * r, 0.0, 10.0 * width_m, epsabs=0.0)
    sent_w = optics.laser_power_w * optics.optical_efficiency * optics.depolarisation
    return float(LAMBDA**2 * sent_w * 0.18 / pi * overlap)


def overlap_of_lagging_modes(range_m: float, turning_radps: float) -> float:
    """Overlap of the transmitted and the received intensity over the overlap in hover, along the lag's direction."""
    waist_m = INSTRUMENT.optics.waist_radius_m
    width_m = sqrt(waist_m**2 + (LAMBDA * range_m / (pi * waist_m)) ** 2)
    lag_m = turning_radps * 2.0 * range_m / C * range_m

    def overlap(apart_m: float) -> float:
        x = np.linspace(-8.0 * width_m, 8.0 * width_m, 4001)
        return float(np.sum(np.exp(-2.0 * (x**2 + (x - apart_m) ** 2) / width_m**2)))

    return overlap(lag_m) / overlap(0.0)


def line_scatter_by_spectrum_bin(range_m: float) -> float:
    """Frequency of a least-squares phase line under white frequency noise, seen over the delay.

    The derivative of the parabola 6/T³ (T²/4 - t²), by which the frequency is weighted, weights the phase.
    """
    tau = 2.0 * range_m / C
    weighted, _ = quad(lambda t: (12.0 * t / RECORD_S**3) ** 2, -RECORD_S / 2, RECORD_S / 2)
    return sqrt(0.5 * WAVE.linewidth_hz / pi * tau**2 * weighted) / BIN_HZ


def beats_by_phase_bin(range_m: float, speed_mps: float) -> list[float]:
    """Observed bins by differences of the phase of the laser less its echo's, in extended precision."""
    found = []
    for start, slope, sign in ((-SLOPE * WAVE.segment_time_s, SLOPE, 1), (0.0, 0.0, -1), (0.0, -SLOPE, -1)):
        u = np.longdouble(WAVE.segment_time_s - RECORD_S / 2)
        step = np.longdouble(1e-7)

        def phase(offset: Any, start: float = start, slope: float = slope, u: Any = u) -> Any:
            tau = 2.0 * (np.longdouble(range_m) - np.longdouble(speed_mps) * offset) / C
            since = u + offset
            return (C / np.longdouble(LAMBDA) + start) * tau + slope * (since * tau - tau * tau / 2.0)

        rate_hz = float((phase(step) - phase(-step)) / (2.0 * step))
        found.append(abs(sign * rate_hz) / BIN_HZ)
    return [min(bin_, WAVE.fft_length - bin_) for bin_ in found]


def efficiency(top: dict[int, float], low: dict[int, float], ratio: Any) -> float:
    """Variance of a ratio of two filters by white noise, over the Cramér-Rao bound, averaged over places in the bin."""
    place = np.linspace(-0.5, 0.5, 4001)[1:-1:2]
    lines = {m: np.sin(pi * place) / (pi * (place - m)) for m in range(-2, 3)}
    above = sum(tap * lines[m] for m, tap in top.items())
    below = sum(tap * lines[m] for m, tap in low.items())
    q = above / below
    np.testing.assert_allclose(q, ratio(place), rtol=0, atol=1e-9)
    slope = (ratio(place + 1e-5) - ratio(place - 1e-5)) / 2e-5
    noise = sum((top.get(m, 0.0) - q * low.get(m, 0.0)) ** 2 for m in range(-2, 3))
    return float(np.mean(noise / (2.0 * below**2 * slope**2)) * 4.0 * pi**2 / 6.0)


def path_correlation(away: FloatArray) -> FloatArray:
    """Correlation of the speckle over distances in pitches along a path, averaged over a pitch."""
    here = (np.arange(2000) + 0.5) / 2000

    def weight(place: FloatArray, corner: int) -> FloatArray:
        near = np.abs(place - corner) < 1.5
        return np.where(near, sqrt(8.0 / 9.0) * np.cos(pi / 3.0 * (place - corner)) ** 2, 0.0)

    corners = range(-2, 7)
    return np.array([np.mean(sum(weight(here, k) * weight(here + x, k) for k in corners)) for x in away])


def check_values() -> dict[str, tuple[float, float]]:
    """Values by the code and by a second form, in the units of the page."""
    optics, receiver = INSTRUMENT.optics, INSTRUMENT.receiver
    site, model = bright(), build_receiver(INSTRUMENT)
    far_m, place = 2000.0, (2164.784, 92.388)
    shot = 2.0 * CHARGE_C * receiver.local_oscillator_power_w
    amplifier, digitiser = noise_over_shot(INSTRUMENT, None)

    def others(**changed: Any) -> float:
        """What the noise ahead of the poles loses by a change of the receiver."""
        return (
            amplifier
            - noise_over_shot(
                INSTRUMENT.model_copy(update={"receiver": receiver.model_copy(update=changed)}), None
            )[0]
        )

    echo_w = float(coherent_power_w(INSTRUMENT, site.surface, None, far_m, 1.0))
    photons = 0.4 * echo_by_quadrature_w(far_m) * RECORD_S / CHARGE_C
    adc = 1.0 + 4.0 * BOLTZMANN_J_PER_K * 300.0 / 2000.0 / shot + 1e-18 * 1e-6 / shot + 1e-5
    adc_ratio = (0.05 / 2.0**8) ** 2 / 12.0 / 2000.0**2 / 3e8 / shot
    per_hz = site.surface.reflectance * 270e6 * LAMBDA**4 / (2.0 * pi * C)
    beats = [interpreted(signed_bin)(model, segment, *place) for segment in range(3)]
    by_phase = beats_by_phase_bin(*place)
    away = np.linspace(0.0, 3.0, 121)
    gaussian = np.exp(-2.0 * pi**2 / 27.0 * away**2)
    slope, wave = (3.0 - away) * (1.0 + 0.5 * np.cos(2.0 * pi * away / 3.0)), np.sin(2.0 * pi * away / 3.0)
    closed = 2.0 / 9.0 * (slope + 9.0 / (4.0 * pi) * wave)
    rate_hz_per_s = 2.0 * 3.0 / LAMBDA - 4.0 * SLOPE * 100.0 / C
    return {
        "range bin": (WAVE.range_bin_m, 0.5 * C / SLOPE / (131072 / 6e8)),
        "speed bin": (1e3 * WAVE.speed_bin_mps, 1e3 * LAMBDA / 2.0 / (131072 / 6e8)),
        "record edge": (WAVE.record_edge_range_m, 0.5 * C * (300e-6 - 131072 / 6e8)),
        "Rayleigh range": (rayleigh_range_m(0.017, LAMBDA), pi * 0.017**2 / 1.55e-6),
        "beam radius": (
            1e3 * float(beam_radius_m(np.array(far_m), optics.waist_radius_m, LAMBDA)),
            1e3 * sqrt(0.017**2 + (1.55e-6 * far_m / (pi * 0.017)) ** 2),
        ),
        "echo power": (echo_w, echo_by_quadrature_w(far_m)),
        "carrier-to-noise ratio": (
            10.0 * log10(echo_w * snr_per_w(INSTRUMENT, None)),
            10.0 * log10(photons / (adc + adc_ratio)),
        ),
        "loss by the lag of the receiving beam": (
            10.0 * log10(echo_w / float(coherent_power_w(INSTRUMENT, site.surface, None, far_m, 1.0, 2.0))),
            -10.0 * log10(overlap_of_lagging_modes(far_m, 2.0)),
        ),
        "thermal over shot noise": (
            others(temperature_k=1e-30),
            4.0 * BOLTZMANN_J_PER_K * 300.0 / 2000.0 / shot,
        ),
        "intensity over shot noise": (
            others(relative_intensity_noise_db_per_hz=None),
            1e-18 * 1e-3**2 / shot,
        ),
        "dark over shot noise": (others(dark_current_a=0.0), 1e-8 / 1e-3),
        "digitiser over shot noise": (digitiser, adc_ratio),
        "sunlight over shot noise": (
            10.0 * log10(sunlight_over_shot(INSTRUMENT, site)),
            10.0 * log10(2.0 * per_hz / CHARGE_C),
        ),
        "threshold": (model.threshold, log(65536 / 1e-3)),
        "up-chirp bin": (round(abs(beats[0])), round(by_phase[0])),
        "constant bin": (round(beats[1]), round(by_phase[1])),
        "down-chirp bin": (round(beats[2]), round(by_phase[2])),
        "line scatter": (sqrt(interpreted(line_variance)(model, far_m)), line_scatter_by_spectrum_bin(far_m)),
        "line loss": (
            -10.0 * log10(interpreted(line_share)(model, far_m)),
            20.0 * pi * 3e3 * 2.0 * far_m / C / log(10.0),
        ),
        "smear of the down-chirp": (
            interpreted(smear_bins)(model, 2, 100.0, 3.0),
            rate_hz_per_s * RECORD_S / BIN_HZ,
        ),
        "Cramér-Rao bound": (sqrt(CRAMER_RAO_BIN2), sqrt(6.0) / (2.0 * pi)),
        "efficiency of jacobsen": (
            EFFICIENCY[PEAK_METHODS["jacobsen"]],
            efficiency({-1: 1.0, 1: -1.0}, {-1: -1.0, 0: 2.0, 1: -1.0}, lambda d: d),
        ),
        "efficiency of hann": (
            EFFICIENCY[PEAK_METHODS["hann"]],
            efficiency(
                {-2: -1.0, -1: 2.0, 1: -2.0, 2: 1.0},
                {-2: -1.0, 0: 2.0, 2: -1.0},
                lambda d: 1.5 * d / (1.0 - d * d),
            ),
        ),
        "error of the correlation along a path": (
            float(np.max(np.abs(path_correlation(away) - gaussian))),
            float(np.max(np.abs(closed - gaussian))),
        ),
    }


ROUNDED_IN_THE_CODE = {"efficiency of jacobsen": 0.03, "efficiency of hann": 0.01}
"""Relative rounding of the constants."""


def test_check_values_follow_from_the_code_and_from_a_second_form() -> None:
    printed = {row[0]: row[2].split()[0] for row in rows("## Check values")}
    values = check_values()
    assert printed.keys() == values.keys()
    for name, text in printed.items():
        mantissa = text.split("e")[0]
        decimals = len(mantissa.partition(".")[2])
        half = 0.5 * 10.0 ** (float(text.partition("e")[2] or 0) - decimals)
        by_code, by_hand = values[name]
        assert by_hand == pytest.approx(float(text), rel=1e-9, abs=1.001 * half), name
        assert by_code == pytest.approx(by_hand, rel=ROUNDED_IN_THE_CODE.get(name, 2e-4)), name


@pytest.mark.parametrize("combine", COMBINE_METHODS)
@pytest.mark.parametrize("speed_mps", [100.0, -60.0])
def test_systematic_errors_have_the_closed_forms(combine: str, speed_mps: float) -> None:
    range_m, acceleration_mps2, segment_s = 2000.0, -3.0, WAVE.segment_time_s
    model, carrier_hz = build_receiver(INSTRUMENT), C / LAMBDA
    beats = [
        interpreted(signed_bin)(
            model, segment, range_m - speed_mps * t_s, speed_mps + acceleration_mps2 * t_s
        )
        for segment, t_s in enumerate((-segment_s, 0.0, segment_s))
    ]
    found = BEAT_WEIGHTS[COMBINE_METHODS[combine]][int(speed_mps < 0.0)] @ np.array(beats)
    range_error_m = found[0] * WAVE.range_bin_m - range_m
    speed_error_mps = found[1] * WAVE.speed_bin_mps - speed_mps
    decelerating_m = C * segment_s * acceleration_mps2 / (LAMBDA * SLOPE) + 2.0 * speed_mps * range_m / C
    if combine == "least_squares":
        expected_m = decelerating_m - speed_mps * (segment_s - RECORD_S) / 2.0
        expected_mps = -speed_mps * SLOPE * segment_s / carrier_hz
    else:
        late_s = 2.0 * segment_s - RECORD_S / 2.0 if speed_mps > 0.0 else -segment_s - RECORD_S / 2.0
        expected_m, expected_mps = decelerating_m - speed_mps * late_s, 0.0
    assert range_error_m == pytest.approx(expected_m, abs=1e-5)
    assert speed_error_mps == pytest.approx(expected_mps, abs=1e-7)

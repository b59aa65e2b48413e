"""Extremes of one beam: what arrives, with which instrument, and what may be reported."""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import Any

import numpy as np
from instruments import C_MPS, echoes, plain
from outcomes import ANYWHERE, Beams, Extreme, measure_beams

from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import Echoes, Reason
from lidar_emu.scenario.instrument import Instrument, Waveform

PUBLISHED = plain()
FINE = {"peak": "hann", "combine": "least_squares"}
JOINT = plain(**FINE)
ANY_TWO = plain(**FINE, rule="any_two")
DEFAULTS = Instrument()
NYQUIST_MPS = 1550e-9 * 600e6 / 4
EDGE_M = Waveform().record_edge_range_m

_VALID = frozenset({Reason.VALID})
_SILENT = frozenset({Reason.BELOW_THRESHOLD})
_FAINT = _VALID | _SILENT
_AMBIGUOUS = _VALID | {Reason.AMBIGUOUS}
_BEYOND = frozenset({Reason.BEYOND_RANGE})
_ANY = frozenset(Reason) - {Reason.NOT_FIRED, Reason.NO_SURFACE}


def _power_w(instrument: Instrument, snr_db: float) -> float:
    return float(10 ** (snr_db / 10) / build_receiver(instrument).snr_per_w)


def _point(
    instrument: Instrument,
    range_m: object,
    speed_mps: object,
    snr_db: float = 60.0,
    shots: int = 50,
    rate_mps: float | None = None,
    acceleration_mps2: float = 0.0,
) -> Beams:
    """One scatterer fixed to the ground, unless its range changes with `rate_mps`; each of them in `shots` shots."""
    cases = np.broadcast_arrays(np.ravel(range_m).astype(float), np.ravel(speed_mps).astype(float))
    range_m, speed_mps = (np.repeat(case, shots)[:, None, None] for case in cases)
    rate = -speed_mps if rate_mps is None else rate_mps
    beams = echoes(range_m, speed_mps, _power_w(instrument, snr_db), range_rate_mps=rate)
    acceleration = np.full(beams.fired.shape, acceleration_mps2)
    return instrument, beams._replace(closing_acceleration_mps2=acceleration)


def _footprint(instrument: Instrument, spread_bin: float, beamlets: int, shots: int, seed: int = 5) -> Beams:
    """Beamlets at random places within so many bins of range, of 60 dB together."""
    rng = np.random.default_rng(seed)
    shape = (shots, 1, beamlets)
    range_m = 2000 + 0.343085 * spread_bin * rng.uniform(-0.5, 0.5, shape)
    share = rng.uniform(0.5, 1.0, shape)
    power_w = share / share.sum(axis=-1, keepdims=True) * _power_w(instrument, 60.0)
    return instrument, echoes(range_m, np.full(shape, 50.0), power_w, range_rate_mps=-50.0)


def _with(instrument: Instrument, **optics: Any) -> Instrument:
    return instrument.model_copy(update={"optics": instrument.optics.model_copy(update=optics)})


def _line(width_hz: float) -> Instrument:
    return plain({"linewidth_hz": width_hz}, **FINE)


def _altered(**columns: float) -> Beams:
    """A beam of which columns hold something else everywhere."""
    instrument, beams = _point(JOINT, 1000.0, 50.0, shots=3)
    return instrument, beams._replace(**{k: np.full_like(getattr(beams, k), v) for k, v in columns.items()})


def _around(value: float, steps: int = 2) -> list[float]:
    """A number and its neighbours to the last bit."""
    found = [value]
    for _ in range(steps):
        found = [float(np.nextafter(found[0], -np.inf)), *found, float(np.nextafter(found[-1], np.inf))]
    return found


def _zero_of_up_chirp(waveform: Waveform, range_m: float) -> float:
    """The closing speed at which g₊ = 0."""
    beat_hz = waveform.chirp_slope_hz_per_s * 2 * range_m / C_MPS
    optical_hz = C_MPS / waveform.wavelength_m - waveform.chirp_slope_hz_per_s * waveform.record_time_s / 2
    return beat_hz / (optical_hz - beat_hz) * C_MPS / 2


def _all_nan() -> list[Beams]:
    instrument, beams = _footprint(JOINT, 1.0, 19, 3)
    return [(instrument, beams._replace(range_m=np.full_like(beams.range_m, np.nan)))]


def _some_nan() -> list[Beams]:
    """Seven of nineteen beamlets meet nothing; the rest is as bright as ever."""
    instrument, beams = _footprint(JOINT, 1.0, 19, 20)
    missing = np.arange(19) < 7
    kept = echoes(
        np.where(missing, np.median(beams.range_m[..., 7:], axis=-1, keepdims=True), beams.range_m),
        50.0,
        np.where(missing, 0.0, beams.power_w),
        range_rate_mps=-50.0,
    )
    return [(instrument, kept)]


def _inside() -> list[Beams]:
    instrument, beams = _point(JOINT, 1000.0, 50.0, shots=3)
    flagged: Echoes = beams._replace(inside=~beams.inside)
    return [(instrument, flagged), _point(JOINT, [0.0, -0.0, -5e-324, -1.0, -1e300, -np.inf], 50.0, shots=1)]


def _everything(looks: int, peaks: tuple[str, ...]) -> list[Beams]:
    ways = [
        ("chirp_minus_doppler", "all_three"),
        ("least_squares", "all_three"),
        ("least_squares", "any_two"),
    ]
    return [
        _point(
            plain(peak=p, combine=c, rule=r, window=w, looks=looks),
            [995.1, 1003.7],
            50.3,
            shots=10,
            rate_mps=0.0,
        )
        for p, (c, r), w in product(peaks, ways, ("rect", "hann", "hamming"))
    ]


def _lengths(length: int) -> list[Beams]:
    """The default record with other samples, and the default rate with another record."""
    record_s = 2**17 / 600e6
    same = plain({"fft_length": length, "sample_rate_hz": length / record_s}, **FINE)
    scale = length / 2**17
    rate = {
        "fft_length": length,
        "segment_time_s": 300e-6 * max(1.0, scale),
        "chirp_slope_hz_per_s": 2e12 / max(1.0, scale),
    }
    return [_point(same, 20.0, 0.05, shots=20), _point(plain(rate, **FINE), 2000.0, 50.0, 90.0, shots=20)]


_SPEEDS = np.linspace(2.0, 465.0, 932)
_OFF_FOLDS = _SPEEDS[np.abs(_SPEEDS - NYQUIST_MPS) > 1.0]
_AT_NYQUIST = NYQUIST_MPS + np.array([-1e-3, -1e-6, 0.0, 1e-6, 1e-3])
_TINY = [0.0, 1e-9, -1e-9, 1e-300, 5e-324]
_BLIND = _around(_zero_of_up_chirp(Waveform(), 2164.784))
_NEAR, _FAR = np.geomspace(5.0, 11_990.0, 300), np.linspace(12_000.4, 50_000.0, 400)
_SPECKLED = _with(JOINT, speckle=True)
_SPREADS, _COUNTS = (0.0, 0.3, 3.0, 30.0, 500.0), (1, 2, 5, 127, 4096)
_SNRS_DB = (25.0, 40.0, 60.0, 100.0, 150.0, 200.0)
_METHODS = ("parabola", "jacobsen", "hann", "aboutanios_mulgrew")


def _case(name: str, reasons: frozenset[Reason], runs: Any, **limits: Any) -> Extreme:
    return Extreme(name, reasons, lambda: measure_beams(runs()), **limits)


def _folded(name: str, reasons: frozenset[Reason], runs: Any, **limits: Any) -> Extreme:
    """Where signs need not be resolved."""
    return _case(name, reasons, runs, resolved=False, **limits)


def _points(*args: Any, **keys: Any) -> Any:
    return lambda: [_point(*args, **keys)]


EXTREMES = [
    _folded("v 2 to 465 m/s at 1 km, all folds", _VALID, _points(JOINT, 1000.0, _OFF_FOLDS, shots=1)),
    _folded("the same, receding, at 11.9 km", _VALID, _points(JOINT, 11_900.0, -_OFF_FOLDS, shots=1)),
    _folded(
        "v = λ fs/4 = 232.5 m/s and 1 µm/s, 1 mm/s beside it",
        _FAINT,
        _points(JOINT, 1000.0, _AT_NYQUIST, shots=20),
    ),
    _case("v = 0, ±1e-9, 1e-300, 5e-324 m/s", _FAINT, _points(JOINT, 1000.0, _TINY)),
    _folded("the same, any two segments", _AMBIGUOUS, _points(ANY_TWO, 1000.0, _TINY)),
    _folded("the same, published detector", _FAINT, _points(PUBLISHED, 1000.0, _TINY)),
    _folded(
        "v = 0, all defaults: AC coupling takes the Doppler line",
        _SILENT,
        _points(DEFAULTS, 500.0, 0.0, 30.0),
    ),
    _case("fb = fd to the last bit and two steps beside it", _FAINT, _points(JOINT, 2164.784, _BLIND)),
    _folded("the same, any two segments", _VALID, _points(ANY_TWO, 2164.784, _BLIND)),
    _folded("the same, published detector", _FAINT, _points(PUBLISHED, 2164.784, _BLIND)),
    _case("R 5 m to 11.99 km", _VALID, _points(JOINT, _NEAR, 50.0, shots=2)),
    _folded(
        "R 1 cm to 5 m, closing with 50 m/s",
        _VALID | {Reason.AMBIGUOUS, Reason.INSIDE_GROUND},
        _points(JOINT, np.geomspace(0.01, 5.0, 300), 50.0, shots=1),
    ),
    _case(
        "R 12.0 km to 1 m before the record edge",
        _BEYOND,
        _points(JOINT, [12_000.1, 12_100.0, EDGE_M - 1.0], 50.0),
    ),
    _folded(
        "R 12.0 to 50 km, 40 dB less what the record misses",
        _ANY,
        _points(JOINT, _FAR, 50.0, 40.0, shots=1),
        beside=ANYWHERE,
    ),
    _case(
        "R 20 to 50 km, 15 dB less what the record misses",
        _BEYOND,
        _points(JOINT, np.linspace(20_000, 50_000, 200), 50.0, 15.0, shots=1),
    ),
    _case("R 45 km to 1e300 m and infinite", _BEYOND, _points(JOINT, [45e3, 50e3, 1e9, 1e300, np.inf], 50.0)),
    _case("R 0, negative, or sensor below the ground", frozenset({Reason.INSIDE_GROUND}), _inside),
    _case("all beamlets NaN", frozenset({Reason.NO_SURFACE}), _all_nan),
    _case("7 of 19 beamlets without light", _VALID, _some_nan),
    _case(
        "spread 0 to 3 bins, 127 beamlets in phase",
        _VALID,
        lambda: [_footprint(JOINT, s, 127, 10) for s in (0.0, 1e-9, 0.1, 1.0, 3.0)],
    ),
    _case(
        "spread 0 to 500 bins, 127 beamlets, speckle",
        _AMBIGUOUS,
        lambda: [_footprint(_SPECKLED, s, 127, 10) for s in _SPREADS],
        beside=(0.35, 0.5),
    ),
    _folded(
        "the same, published detector",
        _VALID,
        lambda: [_footprint(_with(PUBLISHED, speckle=True), s, 127, 10) for s in _SPREADS],
        beside=(0.35, 0.5),
    ),
    _case("1 to 4096 coincident beamlets", _VALID, lambda: [_footprint(JOINT, 0.0, n, 5) for n in _COUNTS]),
    _case("the same, speckle", _VALID, lambda: [_footprint(_SPECKLED, 0.0, n, 5) for n in _COUNTS]),
    _case(
        "linewidth 0 to 10 kHz at 500 m",
        _VALID,
        lambda: [_point(_line(w), 500.0, 50.0) for w in (0.0, 1e-9, 1.0, 3e3, 1e4)],
        beside=(0.05, 5e-4),
    ),
    _case(
        "linewidth 0.1 to 1 MHz at 500 m",
        _VALID,
        lambda: [_point(_line(w), 500.0, 50.0, shots=8) for w in (1e5, 3e5, 1e6)],
        beside=(75.0, 0.8),
    ),
    _case(
        "SNR -60 to 5 dB", _SILENT, lambda: [_point(JOINT, 1000.0, 50.0, s) for s in (-60.0, -30.0, 0.0, 5.0)]
    ),
    _folded(
        "SNR 10 to 17 dB",
        _FAINT | _AMBIGUOUS,
        lambda: [_point(JOINT, 1000.0, 50.0, s, 200) for s in (10.0, 13.0, 15.0, 17.0)],
    ),
    _case("SNR 25 to 200 dB", _VALID, lambda: [_point(JOINT, 1000.3, 50.0, s) for s in _SNRS_DB]),
    _case(
        "the same, published detector", _VALID, lambda: [_point(PUBLISHED, 1000.3, 50.0, s) for s in _SNRS_DB]
    ),
    _case(
        "P_fa 1e-2 to 1e-300, 60 dB, all windows",
        _VALID,
        lambda: [
            _point(plain(**FINE, false_alarm_probability=p, window=w), 1000.0, 50.0, shots=10)
            for p in (1e-2, 1e-9, 1e-100, 1e-300)
            for w in ("rect", "hann", "hamming")
        ],
    ),
    _case(
        "power 0, 5e-324, 1e-310, 1e-300 and 1e-150 W",
        _SILENT,
        lambda: [_altered(power_w=p) for p in (0.0, 5e-324, 1e-310, 1e-300, 1e-150)],
    ),
    _case("power 1e-11 to 1 W", _VALID, lambda: [_altered(power_w=p) for p in (1e-11, 1e-6, 1e-3, 1.0)]),
    _case(
        "power 1e300 W, infinite, NaN, negative",
        _FAINT,
        lambda: [_altered(power_w=p) for p in (1e300, np.inf, np.nan, -1.0)],
    ),
    _case(
        "acceleration to ±30 m/s²",
        _VALID,
        lambda: [
            _point(JOINT, 2000.0, 50.0, acceleration_mps2=a) for a in (0.0, 1e-9, 1.0, -10.0, 30.0, -30.0)
        ],
        beside=(0.3, 3e-3),
    ),
    _case(
        "acceleration ±1000 m/s²: a smear of 62 bins",
        _VALID,
        lambda: [_point(JOINT, 2000.0, 50.0, acceleration_mps2=a) for a in (1000.0, -1000.0)],
        beside=(10.7, 0.11),
    ),
    _folded(
        "speed 1e300, acceleration 1e300, rate of range 1e300",
        _ANY,
        lambda: [
            _altered(**{k: v})
            for k in ("closing_speed_mps", "closing_acceleration_mps2", "range_rate_mps")
            for v in (1e300, -1e300)
        ],
        beside=ANYWHERE,
    ),
    _case(
        "speckle's place and drift 1e300, infinite, NaN",
        _VALID,
        lambda: [
            _altered(**{k: v}) for k in ("speckle_place", "speckle_motion") for v in (1e300, np.inf, np.nan)
        ],
    ),
    _case("1 look; peak bin; every combination, rule, window", _VALID, partial(_everything, 1, ("bin",))),
    _folded("1 look; every finer peak, combination, rule, window", _VALID, partial(_everything, 1, _METHODS)),
    _folded(
        "64 looks; every peak, combination, rule, window",
        _VALID,
        partial(_everything, 64, ("bin", *_METHODS)),
    ),
    _folded("256 samples", _VALID, partial(_lengths, 256)),
    _case("2^20 samples", _VALID, partial(_lengths, 2**20)),
]

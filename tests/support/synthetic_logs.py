"""Logs of an imagined lidar whose properties are known, made without the project's own code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class KnownSensor:
    """Properties of a sensor."""

    range_scale_m: float = 0.2
    range_degrees: float = 4.0
    speed_scale_mps: float = 0.05
    speed_degrees: float = 4.0
    range_step_m: float = 0.0
    speed_step_mps: float = 0.0
    highest_speed_mps: float = np.inf
    range_bias_m: float = 0.0
    range_scale_error: float = 0.0
    latency_s: float = 0.0
    speed_bias_mps: float = 0.0
    speed_scale_error: float = 0.0
    dropout_probability: float = 0.0
    false_probability: float = 0.0


def drawn_sensor(seed: int) -> KnownSensor:
    """A sensor drawn by a seed."""
    rng = np.random.default_rng(seed)
    return KnownSensor(
        range_scale_m=float(rng.uniform(0.05, 0.5)),
        range_degrees=float(rng.uniform(2, 12)),
        speed_scale_mps=float(rng.uniform(0.02, 0.3)),
        speed_degrees=float(rng.uniform(2, 12)),
        range_bias_m=float(rng.normal(0, 0.3)),
        range_scale_error=float(rng.normal(0, 1e-3)),
        latency_s=float(rng.uniform(0, 0.05)),
        speed_bias_mps=float(rng.normal(0, 0.05)),
        speed_scale_error=float(rng.normal(0, 1e-3)),
        dropout_probability=float(rng.uniform(0.005, 0.15)),
        false_probability=float(rng.uniform(0.005, 0.05)),
    )


def motion(time_s: Floats, duration_s: float) -> tuple[Floats, Floats]:
    """Range and closing speed of a descent from 1800 m that brakes and pitches a little."""
    share = np.clip(time_s / duration_s, -0.1, 1.1)
    range_m = 30 + 1770 * (1 - share) ** 1.8 * (1 + 0 * share) + 4 * np.sin(0.4 * time_s)
    slope = -1.8 * 1770 * np.abs(1 - share) ** 0.8 / duration_s + 1.6 * np.cos(0.4 * time_s)
    return range_m, -slope


def synthetic_log(
    sensor: KnownSensor, seed: int, duration_s: float = 120.0, rate_hz: float = 10.0, beams: int = 1
) -> dict[str, Floats]:
    """Columns (shots, beams) of a log: what the sensor reports, NaN where nothing, and the truth."""
    rng = np.random.default_rng([seed, 1])
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    shape = (len(time_s), beams)
    true_m, true_mps = (np.repeat(each[:, None], beams, axis=1) for each in motion(time_s, duration_s * 1.05))
    old_m, old_mps = (
        np.repeat(each[:, None], beams, axis=1)
        for each in motion(time_s - sensor.latency_s, duration_s * 1.05)
    )
    range_m = sensor.range_bias_m + (1 + sensor.range_scale_error) * old_m
    range_m = range_m + sensor.range_scale_m * rng.standard_t(sensor.range_degrees, shape)
    speed_mps = sensor.speed_bias_mps + (1 + sensor.speed_scale_error) * old_mps
    speed_mps = speed_mps + sensor.speed_scale_mps * rng.standard_t(sensor.speed_degrees, shape)
    speed_mps = np.minimum(speed_mps, sensor.highest_speed_mps)
    if sensor.range_step_m:
        range_m = np.rint(range_m / sensor.range_step_m) * sensor.range_step_m
    if sensor.speed_step_mps:
        speed_mps = np.rint(speed_mps / sensor.speed_step_mps) * sensor.speed_step_mps
    is_false = rng.random(shape) < sensor.false_probability
    range_m = np.where(is_false, rng.uniform(3000, 6000, shape), range_m)
    lost = rng.random(shape) < sensor.dropout_probability
    range_m, speed_mps = (np.where(lost, np.nan, each) for each in (range_m, speed_mps))
    return {
        "time_s": np.repeat(time_s[:, None], beams, axis=1),
        "range_m": range_m,
        "closing_speed_mps": speed_mps,
        "snr_db": np.full(shape, np.nan),
        "true_range_m": true_m,
        "true_closing_speed_mps": true_mps,
    }

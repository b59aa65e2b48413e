"""Motion within a measurement, against beam geometry differentiated numerically at the three records' times."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import Waveform
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import simulate

C_MPS = 299_792_458.0
WAVEFORM = Waveform(linewidth_hz=0)
SEGMENT_S = WAVEFORM.segment_time_s
QUIET = {
    "waveform": {"linewidth_hz": 0},
    "optics": {"speckle": False, "laser_power_w": 1e3},
    "receiver": {"adc": None, "bandwidth_hz": None, "ac_coupling_hz": 0},
    "detection": {"peak": "aboutanios_mulgrew", "combine": "least_squares", "window": "rect"},
}
"""70 dB above the noise: a reading's scatter is some hundredths of a millimetre."""

ROLL_RAD, ROLL_HZ, ARM_M = np.radians(0.2), 3.0, 3.0
UP_M, SINKING_MPS = 500.0, 20.0
ROWS_HZ = 8000
"""The second derivative of the curve through the rows is of first order in their spacing."""

Planar = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""East and up of the sensor, and of its beam's unit vector, (2, n) each, at times (n,)."""


def rolling(time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A sensor at the end of an arm to the right of a vehicle that sinks steadily and rolls, looking along body z."""
    roll = ROLL_RAD * np.sin(2 * np.pi * ROLL_HZ * time_s)
    up_m = UP_M - SINKING_MPS * time_s
    return (
        np.stack([ARM_M * np.cos(roll), up_m - ARM_M * np.sin(roll)]),
        np.stack([-np.sin(roll), -np.cos(roll)]),
    )


def beam(path: Planar, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Range to a level plane and closing speed (n,), the latter by differences of the sensor's position."""
    step_s = 1e-5
    sensor_m, axis = path(time_s)
    velocity_mps = (path(time_s + step_s)[0] - path(time_s - step_s)[0]) / (2 * step_s)
    return -sensor_m[1] / axis[1], np.sum(velocity_mps * axis, axis=0)


def reading(
    path: Planar, time_s: FloatArray, combine: str = "least_squares"
) -> tuple[FloatArray, FloatArray]:
    """Range and closing speed (n,) that three records make of the true motion; times are of validity."""
    slope, carrier_hz = WAVEFORM.chirp_slope_hz_per_s, C_MPS / WAVEFORM.wavelength_m
    half_s = WAVEFORM.record_time_s / 2
    beats = []
    for segment, chirp, from_carrier_s in ((-1, -1, half_s), (0, 0, 0.0), (1, 1, SEGMENT_S - half_s)):
        range_m, closing_mps = beam(path, time_s + segment * SEGMENT_S)
        shift_hz = slope * 2 * range_m / C_MPS
        optical_hz = carrier_hz - slope * from_carrier_s + chirp * shift_hz
        beats.append(shift_hz * abs(chirp) + (chirp or 1) * optical_hz * 2 * closing_mps / C_MPS)
    up_hz, constant_hz, down_hz = beats
    if combine == "least_squares":
        beat_hz, doppler_hz = (up_hz + down_hz) / 2, (down_hz - up_hz + constant_hz) / 3
    else:
        beat_hz, doppler_hz = down_hz - constant_hz, constant_hz
    return beat_hz * C_MPS / (2 * slope), doppler_hz * WAVEFORM.wavelength_m / 2


@pytest.fixture
def fly(tmp_path: Path, make_flight: Callable[..., FlightScenario]) -> Callable[..., FlightScenario]:
    """Build a flight of one beam along a path given as columns of a table."""

    def made(columns: dict[str, FloatArray], **parts: Any) -> FlightScenario:
        file = tmp_path / "motion.csv"
        names = list(columns)
        rows = np.stack([columns[name] for name in names], axis=1)
        np.savetxt(file, rows, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
        length = {
            axis: {"column": axis, "unit": "m", "rate_column": f"{axis}_rate", "rate_unit": "m/s"}
            for axis in ("east", "up")
            if axis in columns
        }
        angle = {a: {"column": a, "unit": "rad"} for a in ("roll", "pitch") if a in columns}
        table = {
            "kind": "table",
            "file": str(file),
            "time": {"column": "time", "unit": "s"},
            **length,
            **angle,
        }
        nadir = {"pattern": {"kind": "ring", "count": 1, "angle_deg": 0}}
        scene = {"trajectory": table, "scanner": nadir, "instrument": QUIET, "timing": {"rate_hz": 100}}
        return make_flight(**(scene | parts))

    return made


def rolling_columns() -> dict[str, FloatArray]:
    time_s = np.arange(-0.05, 1.05, 1 / ROWS_HZ)
    return {
        "time": time_s - time_s[0],
        "up": UP_M - SINKING_MPS * time_s,
        "up_rate": np.full_like(time_s, -SINKING_MPS),
        "roll": ROLL_RAD * np.sin(2 * np.pi * ROLL_HZ * time_s),
    }


def times_s(run: Measurement) -> FloatArray:
    """Times of validity on the clock of `rolling`, away from the table's ends."""
    return run.time_s[5:-5, 0] - 0.05


def test_rolling_about_a_lever_arm_shifts_range_by_a_decimetre(fly) -> None:
    """±0.2 degrees at 3 Hz, 3 m from the centre: 3.7 m/s² across the arm, c T a / (λ S) of range."""
    run = simulate(fly(rolling_columns(), mounting={"lever_arm_m": [0, ARM_M, 0]}))
    range_m, closing_mps = reading(rolling, times_s(run))
    true_m, true_mps = beam(rolling, times_s(run))
    np.testing.assert_allclose(run.true_range_m[5:-5, 0], true_m, atol=1e-5)
    np.testing.assert_allclose(run.true_closing_speed_mps[5:-5, 0], true_mps, atol=1e-4)
    np.testing.assert_allclose(run.range_m[5:-5, 0], range_m, atol=1e-3)
    np.testing.assert_allclose(run.closing_speed_mps[5:-5, 0], closing_mps, atol=1e-4)
    bias_m = (run.range_m - run.true_range_m)[5:-5, 0]
    accelerating_mps2 = ARM_M * ROLL_RAD * (2 * np.pi * ROLL_HZ) ** 2
    assert accelerating_mps2 == pytest.approx(3.72, abs=0.01)
    assert (np.max(bias_m) - np.min(bias_m)) / 2 == pytest.approx(0.108, abs=0.002)

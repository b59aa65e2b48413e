"""The travel time of the light: readings of a bright beam straight down, against the path of the light."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS as C_MPS
from lidar_emu.scenario.instrument import Waveform

WAVEFORM = Waveform(linewidth_hz=0.0)
BRIGHT = {
    "waveform": {"linewidth_hz": 0},
    "optics": {"speckle": False, "laser_power_w": 1e3},
    "receiver": {"adc": None, "bandwidth_hz": None, "ac_coupling_hz": 0},
    "detection": {"peak": "aboutanios_mulgrew", "combine": "chirp_minus_doppler", "window": "rect"},
}


def _beats_hz(range_m: float, speed_mps: float) -> np.ndarray:
    """Beats of constant segment and down-chirp at the centres of their records, from the times of emission.

    The sensor is at the range r - v t at the time t. Light received at t met the ground at t - (r - v t)/c, and left
    the sensor at t_e with the same way back: t_e (1 - v/c) = t (1 + v/c) - 2 r/c.
    """
    f_hz, slope = C_MPS / WAVEFORM.wavelength_m, WAVEFORM.chirp_slope_hz_per_s
    per_s = (1 + speed_mps / C_MPS) / (1 - speed_mps / C_MPS)
    start_s = 0.5 * WAVEFORM.record_time_s
    centre_s = np.array([0.0, WAVEFORM.segment_time_s])
    emitted_s = per_s * centre_s - 2 * range_m / C_MPS / (1 - speed_mps / C_MPS)
    # The down-chirp starts half a record after the centre of the constant segment.
    laser_hz = np.array([f_hz, f_hz - slope * (centre_s[1] - start_s)])
    then_hz = np.array([f_hz, f_hz - slope * (emitted_s[1] - start_s)])
    return np.asarray(then_hz * per_s - laser_hz)


@pytest.mark.parametrize(("altitude_m", "speed_mps"), [(2000.0, 100.0), (1000.0, 40.0), (5000.0, 80.0)])
def test_readings_are_of_the_ground_when_the_light_met_it(make_flight, altitude_m, speed_mps) -> None:
    waypoints = [
        {"altitude_m": altitude_m, "speed_mps": speed_mps},
        {"altitude_m": altitude_m - 10, "speed_mps": speed_mps},
    ]
    scenario = make_flight(
        instrument=BRIGHT,
        scanner={"pattern": {"kind": "directions", "beams": [[0, 0]]}},
        trajectory={"kind": "profile", "waypoints": waypoints},
        timing={"rate_hz": 200 if speed_mps > 50 else 80},
    )
    run = simulate(scenario)
    range_m, read_m, read_mps = run.true_range_m[:, 0], run.range_m[:, 0], run.closing_speed_mps[:, 0]
    beats_hz = np.array([_beats_hz(r, speed_mps) for r in range_m])
    speed_bin, range_bin = (
        WAVEFORM.speed_bin_mps / WAVEFORM.bin_width_hz,
        WAVEFORM.range_bin_m / WAVEFORM.bin_width_hz,
    )
    # Later than the truth by half of this: the test can tell.
    assert speed_mps**2 / C_MPS > 4e-6
    assert np.median(read_mps - beats_hz[:, 0] * speed_bin) == pytest.approx(0.0, abs=1e-6)
    expected_m = (beats_hz[:, 1] - beats_hz[:, 0]) * range_bin
    assert np.median(read_m - expected_m) == pytest.approx(0.0, abs=5e-5)

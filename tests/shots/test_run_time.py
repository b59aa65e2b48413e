"""The operations that the plan predicts are the ones that a run carries out."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.fmcw.waveform.analog_receiver import AnalogResponse, Poles
from lidar_emu.plan.operations import Operations
from lidar_emu.scenario.instrument import Waveform
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model

ONE_BEAM = {
    "duration_s": "1",
    "site": "flat",
    "scanner": "{pattern: {kind: directions, beams: [[0, 0]]}}",
    "instrument.waveform.linewidth_hz": "0",
}


def operations(**keys: str) -> dict[str, float]:
    """Count the operations of twenty shots of one beam over a plane."""
    scenario = load("descent.yaml", ONE_BEAM | {key.replace("__", "."): value for key, value in keys.items()})
    found = build_model(scenario).plan.operations
    assert isinstance(found, Operations)
    return found.count


def test_geometry_alone():
    assert operations(level="geometric") == {"beams": 20, "rays": 20}


def test_beams_and_tones():
    """19 beamlets and the haze are 20 tones, in three records of each of two looks."""
    found = operations(instrument__detection__looks="2", exact="true")
    assert found | {"beams": 20, "rays": 380, "records": 120, "tones": 2400} == found


def test_bins_are_counted_as_the_kernels_lay_them():
    """A beam at rest: eight bins on each side of a line without width, plus one; no filter."""
    still = (
        "{kind: profile, waypoints: [{altitude_m: 100, speed_mps: 0.01}, {altitude_m: 99, speed_mps: 0.01}]}"
    )
    found = operations(instrument__optics__beamlets="1", trajectory=still)
    assert found["records"] == 60
    assert found["bins"] == pytest.approx(60 * 17, rel=0.02)
    assert found["tones in bins"] == pytest.approx(4 * found["bins"])
    assert found["taps in bins"] == found["nodes of taps"] == 0


def test_a_wide_line_and_many_looks_multiply():
    """1 MHz is 218 bins: 445 taps on each side, and integrals over 150 panels for each tap and record."""
    narrow = operations()
    wide = operations(instrument__waveform__linewidth_hz="1e6")
    many = operations(instrument__waveform__linewidth_hz="1e6", instrument__detection__looks="16")
    assert wide["nodes of taps"] == pytest.approx(60 * 446 * 150 * 16, rel=0.02)
    assert many["nodes of taps"] == pytest.approx(16 * wide["nodes of taps"])
    assert wide["bins"] > 40 * narrow["bins"]
    # The bins of all looks are computed in each, and the surface moves on between them.
    assert many["bins"] > 16 * wide["bins"]


def test_bins_of_haze_are_those_before_the_surface():
    """With haze that is computed everywhere: 100 m are 292 range bins, in two chirps."""
    near = (
        "{kind: profile, waypoints: [{altitude_m: 100, speed_mps: 0.01}, {altitude_m: 99, speed_mps: 0.01}]}"
    )
    air = "{base: flat, atmosphere: {extinction_per_m: 1.0e-4, backscatter_per_m_sr: 1.0e-3}}"
    hazy, clear = operations(trajectory=near, site=air), operations(trajectory=near)
    beats = 100.0 / Waveform().range_bin_m
    assert hazy["bins of bands"] == pytest.approx(20 * 2 * beats, rel=0.02)
    assert hazy["bins"] - clear["bins"] == pytest.approx(hazy["bins of bands"], rel=0.02)
    assert clear["bins of bands"] == 0


@pytest.mark.parametrize("corner_hz", [25.0, 50e3])
def test_samples_are_those_that_pass_the_poles(corner_hz):
    found = operations(
        level="waveform",
        exact="true",
        instrument__receiver__ac_coupling_hz=str(corner_hz),
        instrument__optics__beamlets="7",
    )
    run_in = 25 * 600e6 / (2 * np.pi * corner_hz)
    assert found["receiver samples"] == pytest.approx(60 * (run_in + 2**17), rel=0.01)
    assert found["beamlet samples"] == pytest.approx(7 * found["receiver samples"])
    if corner_hz > 1e3:
        poles = Poles(Waveform(), AnalogResponse(300e6, corner_hz), 150e6)
        assert found["receiver samples"] == pytest.approx(60 * poles.time_s.size, rel=0.05)


def test_the_plan_states_what_takes_the_time():
    def line(**keys):
        scenario = load(
            "descent.yaml", ONE_BEAM | {key.replace("__", "."): value for key, value in keys.items()}
        )
        (found,) = [d for d in build_model(scenario).plan.decisions if d.stage == "computing time"]
        return found

    slow = line(level="waveform", instrument__receiver__ac_coupling_hz="25", instrument__optics__beamlets="1")
    assert "samples with their run-in" in slow.reason
    assert "minutes" in slow.how or "hours" in slow.how
    assert "of the flight's time" in slow.how
    assert "samples" not in line().reason
    echo = line(level="reference")
    assert echo.how == "not predicted"

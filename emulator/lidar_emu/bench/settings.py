"""The settings that the benchmark compares, and a scenario with each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lidar_emu.bench.errors_against_truth import ErrorSpread, false_locks, spread
from lidar_emu.echo.echoes import compute_echoes
from lidar_emu.flight.flight import Flight
from lidar_emu.fmcw.fidelity_levels import build_level
from lidar_emu.fmcw.returns import Echoes, Returns
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.scatterers.level import ScattererLevel
from lidar_emu.scenario.schema import FlightScenario

BEAMLETS = (1, 7, 19, 37, 61, 127)
FINEST = BEAMLETS[-1]

LevelName = Literal["geometric", "spectral", "waveform", "reference"]


@dataclass(frozen=True)
class Setting:
    """A level with its number of beamlets and skip rules."""

    level: LevelName
    beamlets: int
    exact: bool = True
    """Nothing is left out by the skip rules; other levels than `spectral` have none that matter."""

    @property
    def name(self) -> str:
        """Name in tables and plots."""
        if self.level == "reference":
            return "scatterers"
        if self.level == "geometric":
            return self.level
        skips = ", skips" if not self.exact else ""
        return f"{self.level} {self.beamlets}{skips}"

    def of(self, scenario: FlightScenario) -> FlightScenario:
        """The scenario at this setting."""
        share = 0.0 if self.exact else scenario.left_out_share
        return scenario.model_copy(update={"level": self.level, "left_out_share": share})


FAST = (
    Setting("geometric", 1),
    *(Setting("spectral", count, exact=False) for count in BEAMLETS),
    *(Setting("spectral", count) for count in BEAMLETS),
)
SLOW = tuple(Setting("waveform", count) for count in BEAMLETS)
REFERENCE = Setting("reference", FINEST)
SAMPLED = Setting("waveform", FINEST)
TWIN = Setting("spectral", FINEST)
"""The fast setting with the same echoes and draws of speckle as `SAMPLED`: its twin."""


def light(scenario: FlightScenario, flight: Flight, beamlets: int, shot: NDArray[np.int64]) -> Echoes:
    """Echoes of shots anywhere in the flight, in ascending order."""
    pointing, _ = flight.point(shot, flight.scanner.initial)
    hits = flight.cast(pointing)
    return compute_echoes(scenario.instrument, scenario.site, flight, beamlets, pointing, hits)


def measure(
    setting: Setting, scenario: FlightScenario, flight: Flight, shot: NDArray[np.int64], runs: int = 1
) -> ErrorSpread:
    """Errors of shots at a setting, against the truth along the beams' axes.

    Args:
        runs: number of runs, each with the next seed.
    """
    pointing, _ = flight.point(shot, flight.scanner.initial)
    hits = flight.cast(pointing)
    echoes = compute_echoes(scenario.instrument, scenario.site, flight, setting.beamlets, pointing, hits)
    true_mps = dot(pointing.sensor_velocity_site_mps, pointing.true_site)
    waveform = scenario.instrument.waveform
    bins = waveform.range_bin_m, waveform.speed_bin_mps
    range_error_m, speed_error_mps, false = [], [], []
    for run in range(runs):
        seeded = reseeded(setting.of(scenario), run)
        if setting == REFERENCE:
            returns = ScattererLevel(seeded, flight).measure(pointing, hits, shot)
        else:
            returns = build_level(seeded)(echoes, shot)
        range_error_m.append(returns.range_m - hits.range_m)
        speed_error_mps.append(returns.closing_speed_mps - true_mps)
        false.append(false_locks(returns, echoes, *bins))
    expected = np.tile(pointing.fired & np.isfinite(hits.range_m), (runs, 1))
    return spread(
        np.concatenate(range_error_m), np.concatenate(speed_error_mps), np.concatenate(false), expected
    )


def reseeded(scenario: FlightScenario, by: int) -> FlightScenario:
    """The same scenario with a later seed."""
    return scenario.model_copy(update={"seed": (scenario.seed + by) % 2**63})


def quiet(scenario: FlightScenario) -> FlightScenario:
    """The same flight with sixty decibels more light, an ideal digitiser, zero linewidth and sub-bin peaks.

    The remaining difference between two levels is then not due to noise.
    """
    instrument = scenario.instrument
    optics = instrument.optics.model_copy(update={"laser_power_w": 1e6 * instrument.optics.laser_power_w})
    changed = instrument.model_copy(
        update={
            "optics": optics,
            "waveform": instrument.waveform.model_copy(update={"linewidth_hz": 0.0}),
            "receiver": instrument.receiver.model_copy(update={"adc": None}),
            "detection": instrument.detection.model_copy(update={"peak": "hann"}),
        }
    )
    return scenario.model_copy(update={"instrument": changed})


def one_beam(echoes: Echoes, rows: slice) -> Echoes:
    """The first beam of some shots."""
    arrays: tuple[NDArray[Any], ...] = echoes
    return Echoes(*(values[rows, :1] for values in arrays))


def rms_apart(one: Returns, other: Returns) -> tuple[float, float]:
    """Root mean square differences of range and speed where both are valid; NaN if none is."""
    both = one.range_valid & other.range_valid
    if not both.any():
        return np.nan, np.nan
    range_m = (one.range_m - other.range_m)[both]
    speed_mps = (one.closing_speed_mps - other.closing_speed_mps)[both]
    return float(np.sqrt(np.mean(range_m**2))), float(np.sqrt(np.mean(speed_mps**2)))

"""Tables of docs/evidence/accuracy.md on the stated sigma: errors in standard deviations, by level and with looks.

A single beam over level ground, 7.5 degrees off nadir, sinking slowly while it moves sideways: bias by deceleration and
by the segments' optical frequencies is left out by subtracting the median error. Sub-bin peaks with least squares, bins
by the published detector. Only correct locks count, and only cells in which at least half of the shots have one.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import atan2, degrees, hypot
from typing import Any, NamedTuple

import numpy as np

import lidar_emu
from benchmarks.scenes import FAST_LEVELS, REFERENCE, scanner, trajectory
from benchmarks.tables import TABLES, Part
from lidar_emu.scenario.load import load

HEADINGS = (
    "peak", "linewidth", "speckle", "altitude", "level", "correct",
    "range error / sigma", "beyond 2, 3 %", "speed error / sigma", "beyond 2, 3 %",
)  # fmt: skip
PLACES = (50.0, 10.0), (300.0, 20.0), (1000.0, 20.0), (2000.0, 30.0), (3000.0, 30.0)
"""Altitude in metres and speed sideways in metres per second."""

LINEWIDTHS_HZ = 0.0, 3e3, 30e3
FAST_SHOTS = TABLES["sigma"].fast_times

_RATE_HZ = 500.0
_NEAR_M, _NEAR_MPS = 5.0, 0.05
"""Errors of correct locks."""


class Scores(NamedTuple):
    """Errors over their stated standard deviation."""

    deviation: float
    """Root mean square of quantised errors, robust deviation of others."""
    beyond_two: float
    beyond_three: float

    @classmethod
    def from_errors(cls, error: Any, sigma: Any, quantised: bool) -> Scores:
        """Scores of errors without their median."""
        score = (error - np.median(error)) / sigma
        deviation = score.std() if quantised else 1.4826 * np.median(np.abs(score))
        return cls(float(deviation), *(float(np.mean(np.abs(score) > limit)) for limit in (2.0, 3.0)))

    def cells(self) -> tuple[str, str]:
        """Two cells of a row."""
        return f"{self.deviation:.2f}", f"{100 * self.beyond_two:.1f}, {100 * self.beyond_three:.1f}"


class Cell(NamedTuple):
    """An instrument at a place."""

    peak: str
    linewidth_hz: float
    speckle: bool
    altitude_m: float
    sideways_mps: float
    sink_mps: float = 2.0
    off_nadir_deg: float = 7.5
    looks: int = 1

    def settings(self, shots: int) -> dict[str, str]:
        """Keys of a scenario. Its speed changes by many bins, so that a quantised speed is anywhere in its bin."""
        # Without speckle several beamlets are a mirror, whose edges pass the beam.
        optics = "{speckle: true}" if self.speckle else "{speckle: false, beamlets: 1}"
        combine = "chirp_minus_doppler" if self.peak == "bin" else "least_squares"
        rate_hz = _RATE_HZ / self.looks
        half_m = 0.505 * self.sink_mps * shots / rate_hz
        speed_mps = hypot(self.sideways_mps, self.sink_mps)
        path_deg = degrees(atan2(self.sink_mps, self.sideways_mps))
        return {
            "timing.rate_hz": str(rate_hz),
            "duration_s": str(shots / rate_hz),
            "instrument": f"{{base: ndl_fine, "
            f"detection: {{peak: {self.peak}, combine: {combine}, looks: {self.looks}}}, "
            f"waveform: {{linewidth_hz: {self.linewidth_hz}}}, optics: {optics}}}",
            "site": "{base: flat, surface: {reflectance: 0.18, lommel_seeliger_share: 1}}",
            "scanner": scanner(self.off_nadir_deg),
            "trajectory": trajectory(self.altitude_m, half_m, speed_mps, 0.05, f"path_angle_deg: {path_deg}"),
        }

    def scores(self, level: dict[str, str], shots: int) -> tuple[float, Scores, Scores]:
        """Share of correct locks, and scores of range and closing speed."""
        run = lidar_emu.simulate(load("descent", self.settings(shots) | level), seed=1)
        errors = run.range_m - run.true_range_m, run.closing_speed_mps - run.true_closing_speed_mps
        good = run.range_valid & (np.abs(errors[0]) < _NEAR_M) & (np.abs(errors[1]) < _NEAR_MPS)
        quantised = self.peak == "bin"
        ranges, speeds = (
            Scores.from_errors(error[good], sigma[good], quantised)
            for error, sigma in zip(errors, (run.sigma_range_m, run.sigma_speed_mps), strict=True)
        )
        return float(good.mean()), ranges, speeds


def parts(shots: int) -> Iterator[Part]:
    """The reference and the fast levels where there is speckle, level spectral elsewhere."""
    yield HEADINGS
    peaks = "bin", "hann", "parabola", "jacobsen", "aboutanios_mulgrew"
    for peak, linewidth_hz, speckle in product(peaks, LINEWIDTHS_HZ, (True, False)):
        # The reference has no others.
        if speckle and peak in ("parabola", "jacobsen"):
            continue
        levels: list[tuple[str, dict[str, str], int]] = [("spectral", {}, FAST_SHOTS * shots)]
        if speckle:
            levels.insert(0, ("scatterers", REFERENCE, shots))
        for altitude_m, sideways_mps in PLACES:
            cell = Cell(peak, linewidth_hz, speckle, altitude_m, sideways_mps)
            for name, level, count in levels:
                share, *both = cell.scores(level, count)
                cells = [cell for score in both for cell in score.cells()]
                row = (
                    peak, f"{linewidth_hz / 1e3:g} kHz", "on" if speckle else "off", f"{altitude_m:g} m",
                    name, f"{share:.2f}", *cells,
                )  # fmt: skip
                if share >= 0.5:
                    yield row


class Place(NamedTuple):
    """Motion and beam over level ground, and the instrument where it has other peaks or light."""

    altitude_m: float
    sideways_mps: float
    sink_mps: float
    off_nadir_deg: float = 7.5
    peak: str = "hann"
    speckle: bool = True


LOOKS_PLACES = (
    Place(300.0, 20.0, 0.2, 0.0),
    Place(300.0, 20.0, 2.0),
    Place(50.0, 10.0, 0.2),
    Place(2000.0, 30.0, 2.0),
    Place(100.0, 1.0, 0.2),
    Place(300.0, 100.0, 2.0, 0.0),
    Place(300.0, 20.0, 2.0, speckle=False),
    Place(300.0, 20.0, 2.0, peak="bin"),
)


def looks_parts(shots: int) -> Iterator[Part]:
    """The same ratios with several looks, without a line; the reference has no looks."""
    scores = HEADINGS[-4:]
    yield "altitude; sideways, down; beam", "looks", "level", *scores
    for place, looks, level in product(LOOKS_PLACES, (4, 16), FAST_LEVELS):
        cell = Cell(place.peak, 0.0, place.speckle, *place[:4], looks)
        _, *both = cell.scores(FAST_LEVELS[level], shots)
        scene = f"{place.altitude_m:g} m; {place.sideways_mps:g}, {place.sink_mps:g} m/s; {place.off_nadir_deg:g}°"
        scene += "" if place.speckle else ", no speckle"
        scene += ", quantised" if place.peak == "bin" else ""
        yield scene, str(looks), level, *(cell for score in both for cell in score.cells())

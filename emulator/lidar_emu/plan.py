"""What a run needs and what it leaves out, each with its reason and the bound on what that costs."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from lidar_emu.flight import Flight
from lidar_emu.rotations import dot
from lidar_emu.scanner.footprint import beam_radius_m, wavefront_radius_m
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.scenario.site import Grid

ONE_BEAMLET_BELOW_BINS = 0.1
_SAMPLES = 256


@dataclass(frozen=True)
class Decision:
    """One stage of the model, computed or left out."""

    stage: str
    computed: bool
    how: str
    reason: str
    bound: str
    """The largest effect of the decision; `exact` where there is none."""


@dataclass(frozen=True)
class Plan:
    """The decisions of a run, and the one figure that the model takes from them."""

    decisions: tuple[Decision, ...]
    beamlets: int = 1

    def rows(self) -> list[dict[str, str | bool]]:
        """The decisions for JSON."""
        return [asdict(decision) for decision in self.decisions]


def plan_bench(scenario: BenchScenario) -> Plan:
    """A bench pattern computes nothing but itself."""
    beams = len(scenario.bench_pattern.beams)
    return Plan(
        (
            Decision("pattern", True, f"{beams} beams", "the scenario gives bench_pattern", "exact"),
            Decision("flight, ground, receiver", False, "-", "a pattern needs none of them", "exact"),
        )
    )


def plan_flight(scenario: FlightScenario, flight: Flight) -> Plan:
    """Decide each stage for the whole run."""
    footprint, beamlets = _footprint(scenario, flight)
    decisions = [
        _trajectory(flight),
        *_ground(scenario, flight),
        _air(scenario),
        footprint,
        *_scanner(flight),
    ]
    return Plan(tuple(decisions), beamlets)


def _trajectory(flight: Flight) -> Decision:
    trajectory = flight.trajectory
    gaps = ", ".join(f"{g.column} {g.length_s:.1f} s from {g.start_s:.1f} s" for g in trajectory.gaps)
    return Decision(
        "trajectory",
        True,
        f"{flight.shot_count} shots in {flight.shot_count * flight.period_ns * 1e-9:.3f} s",
        f"gaps bridged: {gaps}" if gaps else "no gaps",
        "as interpolated" if gaps else "exact",
    )


def _ground(scenario: FlightScenario, flight: Flight) -> list[Decision]:
    ground = scenario.site.ground
    if not isinstance(ground, Grid):
        return [
            Decision("ground", True, flight.scene.description, f"a {ground.kind} is a formula", "exact"),
            Decision("grid traversal", False, "-", "the site has no elevation grid", "exact"),
        ]
    return [
        Decision("ground", True, flight.scene.description, "the site has an elevation grid", "exact"),
        Decision(
            "curvature of the grid",
            False,
            "map plane",
            "grids are read on their map plane",
            "0.2 m at 830 m on the Moon",
        ),
    ]


def _air(scenario: FlightScenario) -> Decision:
    air = scenario.site.atmosphere
    if air is None or air.extinction_per_m == 0:
        return Decision("atmosphere", False, "vacuum", f"{scenario.site.name} has none", "exact")
    loss_db = 20 * np.log10(np.e) * air.extinction_per_m * scenario.instrument.detection.maximum_range_m
    return Decision("atmosphere", True, "extinction", f"up to {loss_db:.2f} dB at maximum range", "exact")


def _scanner(flight: Flight) -> list[Decision]:
    if flight.scanner.needs_ground_altitude:
        return []
    return [Decision("ground altitude", False, "-", "no switch counts its altitude from the ground", "exact")]


def _footprint(scenario: FlightScenario, flight: Flight) -> tuple[Decision, int]:
    """One beamlet stands for the footprint where its spectrum is narrow beside a bin, as far as can be known before
    the run: over a plane or a sphere. A spectrum of rms width s bins loses pi² s²/3 of its peak and moves by less
    than its own skew; on a grid the facets are unknown until they are hit."""
    asked = scenario.instrument.optics.beamlets
    if asked == 1:
        return Decision("footprint", False, "1 beamlet", "the instrument asks for one", "as asked"), 1
    if isinstance(scenario.site.ground, Grid):
        return Decision("footprint", True, f"{asked} beamlets", "slopes of a grid vary", "exact"), asked
    spread = spectral_spread_bins(scenario, flight)
    if spread < ONE_BEAMLET_BELOW_BINS:
        bound = f"{100 * np.pi**2 / 3 * spread**2:.2g} % of the peak's power"
        return Decision("footprint", False, "1 beamlet", f"rms spread {spread:.3f} bin", bound), 1
    return Decision("footprint", True, f"{asked} beamlets", f"rms spread {spread:.3f} bin", "exact"), asked


def spectral_spread_bins(scenario: FlightScenario, flight: Flight) -> float:
    """Largest rms width of a beam's spectrum over the flight, in bins, over a plane or a sphere.

    The echo weighs the footprint by exp(-4 r²/w²): rms w / sqrt(8) along one axis. Range varies by tan(incidence) times
    that; closing speed by the transverse speed over the radius of the wavefront.
    """
    waveform, optics = scenario.instrument.waveform, scenario.instrument.optics
    shot = np.unique(np.linspace(0, flight.shot_count - 1, _SAMPLES).astype(np.int64))
    pointing, _ = flight.point(shot, flight.scanner.initial)
    hits = flight.cast(pointing.sensor_site_m, pointing.true_site)
    radius_m = beam_radius_m(hits.range_m, optics.waist_radius_m, waveform.wavelength_m)
    curvature_m = wavefront_radius_m(hits.range_m, optics.waist_radius_m, waveform.wavelength_m)
    cosine = np.abs(dot(hits.normal_site, pointing.true_site))
    tangent = np.sqrt(np.maximum(0.0, 1 - cosine**2)) / cosine
    along_mps = dot(pointing.sensor_velocity_site_mps, pointing.true_site)
    total_mps = np.sqrt(dot(pointing.sensor_velocity_site_mps, pointing.sensor_velocity_site_mps))
    across_mps = np.sqrt(np.maximum(0.0, total_mps**2 - along_mps**2))
    by_range_hz = waveform.chirp_slope_hz_per_s * 2 * tangent / SPEED_OF_LIGHT_MPS
    by_speed_hz = 2 * across_mps / curvature_m / waveform.wavelength_m
    spread = radius_m / np.sqrt(8) * (by_range_hz + by_speed_hz) / waveform.bin_width_hz
    return float(np.nanmax(spread, initial=0.0))

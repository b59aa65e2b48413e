"""What a flight needs and what it leaves out, each with its reason and the bound on what that costs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.echo.echoes import compute_echoes
from lidar_emu.echo.spectral_spread import spread_bins
from lidar_emu.flight.flight import Flight, sensor_height_m
from lidar_emu.flight.pointing import Pointing
from lidar_emu.plan.faults import planned_faults
from lidar_emu.plan.ground import plan_objects, plan_parts
from lidar_emu.plan.plan import Decision, Plan
from lidar_emu.plan.receiver import plan_receiver
from lidar_emu.scenario.generated_ground import Generated
from lidar_emu.scenario.mesh_ground import Mesh
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.site import ElevationGrid, Nested
from lidar_emu.scenario.trajectory import PoweredDescent
from lidar_emu.scene.ray_hits import Hits
from lidar_emu.scene.terrain.read import lies_flat

if TYPE_CHECKING:
    from lidar_emu.flight.recorded_file import GeometryFile

ONE_BEAMLET_BELOW_BINS = 0.1
_LOOK_EVERY_S = 0.1


def plan_flight(scenario: FlightScenario, flight: Flight) -> Plan:
    """Decide each stage for the whole run, from a look at the flight every tenth of a second."""
    if flight.is_live:
        return _plan_unknown(scenario, flight)
    pointing, hits = _look(flight)
    echoes = compute_echoes(scenario.instrument, scenario.site, flight, 1, pointing, hits)
    footprint, beamlets = _footprint(scenario, pointing, hits)
    decisions = (
        *_flown(scenario, flight, pointing, hits),
        _air(scenario),
        *_dust(scenario, float(np.min(sensor_height_m(pointing, hits)))),
        footprint,
        *plan_receiver(scenario, echoes),
        *planned_faults(scenario),
    )
    return Plan(decisions, beamlets)


def _plan_unknown(scenario: FlightScenario, flight: Flight) -> Plan:
    """Of a flight that is yet to be flown nothing is ruled out that depends on it."""
    beamlets = 1 if scenario.level == "geometric" else scenario.instrument.optics.beamlets
    kept = "the flight becomes known as it is flown"
    return Plan(
        (
            Decision("trajectory", True, "live truth", kept, "as interpolated"),
            Decision("ground", True, flight.scene.description, kept, "exact"),
            _air(scenario),
            *_dust(scenario, 0.0),
            Decision("footprint", beamlets > 1, f"{beamlets} beamlets", kept, "sampled"),
            *_switching(flight),
            Decision("receiver", True, scenario.level, f"the scenario asks for level {scenario.level}", kept),
            *planned_faults(scenario),
        ),
        beamlets,
    )


def _look(flight: Flight) -> tuple[Pointing, Hits]:
    """Beams and where they hit along the flight, with every pattern chosen as it will be."""
    step = max(1, round(_LOOK_EVERY_S * 1e9 / flight.period_ns))
    shot = np.unique(np.append(np.arange(0, flight.shot_count, step, dtype=np.int64), flight.shot_count - 1))
    pointing, _ = flight.point(shot, flight.scanner.initial)
    return pointing, flight.cast(pointing)


def _flown(scenario: FlightScenario, flight: Flight, pointing: Pointing, hits: Hits) -> list[Decision]:
    """What says where the beams are and what they meet."""
    if flight.recorded_geometry is not None:
        return [_recorded(flight.recorded_geometry)]
    return [
        _trajectory(scenario, flight),
        *_bridges(flight),
        *_ground(scenario, flight, pointing, hits),
        *plan_objects(flight.scene, flight.ground),
        *_switching(flight),
    ]


def _recorded(geometry: GeometryFile) -> Decision:
    metadata = geometry.metadata
    how = f"{geometry.path.name}: {metadata.shots} shots of {metadata.beams} beams, {metadata.beamlets} rays each"
    reason = f"the geometry of {metadata.name} is given"
    return Decision("trajectory, ground, casting", False, how, reason, "as recorded, bit for bit")


def _trajectory(scenario: FlightScenario, flight: Flight) -> Decision:
    if isinstance(scenario.trajectory, PoweredDescent):
        return _powered_descent(flight, scenario.trajectory.target.up_m)
    gaps = ", ".join(f"{g.column} {g.length_s:.1f} s from {g.start_s:.1f} s" for g in flight.trajectory.gaps)
    return Decision(
        "trajectory",
        True,
        f"{flight.shot_count} shots in {flight.shot_count * flight.period_ns * 1e-9:.3f} s",
        f"gaps bridged: {gaps}" if gaps else "no gaps",
        "as interpolated" if gaps else "exact",
    )


def _bridges(flight: Flight) -> list[Decision]:
    """The gaps of a table that are longer than it allows, of columns that lack the same rows together."""
    columns: dict[tuple[float, float], list[str]] = {}
    for gap in flight.trajectory.bridged:
        columns.setdefault((gap.start_s, gap.start_s + gap.length_s), []).append(gap.column)
    return [
        Decision(
            "gap", True, f"bridged from {start_s:.1f} s to {end_s:.1f} s", ", ".join(names), "unknown there"
        )
        for (start_s, end_s), names in columns.items()
    ]


def _powered_descent(flight: Flight, ground_m: float) -> Decision:
    """With how far the level ground of the touchdown is from the scene's own there."""
    from lidar_emu.trajectory.powered.trajectory import DescentTrajectory

    descent = flight.trajectory
    assert isinstance(descent, DescentTrajectory)
    course, landed = descent.course, descent.state(np.array([descent.course.touchdown_s]))
    east_m, north_m, _ = landed.position_site_m[0]
    apart_m = float(flight.scene.height_m(np.array([east_m]), np.array([north_m]))[0]) - ground_m
    speed_mps = float(np.sqrt(np.sum(landed.velocity_site_mps**2)))
    how = f"{course.steps} steps in {course.end_s:.3f} s, {flight.shot_count} shots"
    reason = (
        f"cut-off at {course.cut_off_s:.3f} s, touchdown at {course.touchdown_s:.3f} s with {speed_mps:.2f} m/s, "
        f"{east_m:.1f} m east, {north_m:.1f} m north; {descent.propellant_kg:.1f} kg burnt"
    )
    bound = f"fourth order in the step; ground there {apart_m:+.2f} m off target.up_m"
    return Decision("trajectory", True, how, reason, bound)


def _ground(scenario: FlightScenario, flight: Flight, pointing: Pointing, hits: Hits) -> list[Decision]:
    ground = scenario.site.ground
    if isinstance(ground, Mesh):
        return [Decision("ground", True, flight.scene.description, "the site has a mesh", "exact")]
    if not isinstance(ground, ElevationGrid | Generated | Nested):
        return [
            Decision("ground", True, flight.scene.description, f"a {ground.kind} is a formula", "exact"),
            Decision("grid traversal", False, "-", "the site has no elevation grid", "exact"),
        ]
    told = Decision("ground", True, flight.scene.description, "the site has an elevation grid", "exact")
    parts = list(plan_parts(flight.ground))
    grids = ground.grids if isinstance(ground, Nested) else [ground]
    if not any(isinstance(grid, Generated) or lies_flat(grid) for grid in grids):
        on_body = "by the map's projection"
        return [told, Decision("curvature of the grid", True, on_body, "the file states it", "exact"), *parts]
    horizontal_m = (pointing.sensor_site_m + hits.range_m[..., None] * pointing.true_site)[..., :2]
    away_m = float(np.sqrt(np.nanmax((horizontal_m**2).sum(axis=-1), initial=0.0)))
    fall_m = away_m**2 / (2 * scenario.site.body.radius_m)
    bound = f"{fall_m:.2g} m of height, {away_m:.0f} m from the origin"
    return [told, Decision("curvature of the grid", False, "map plane", "the grid lies flat", bound), *parts]


def _air(scenario: FlightScenario) -> Decision:
    air = scenario.site.atmosphere
    if air is None or air.extinction_per_m == 0:
        return Decision("extinction", False, "vacuum", f"{scenario.site.name} has none", "exact")
    loss_db = 20 * np.log10(np.e) * air.extinction_per_m * scenario.instrument.detection.maximum_range_m
    return Decision("extinction", True, "exp(-2αR)", f"up to {loss_db:.2f} dB at maximum range", "exact")


def _dust(scenario: FlightScenario, lowest_m: float) -> list[Decision]:
    """Of a scenario whose plume raises some."""
    plume, level = scenario.plume, scenario.level
    if plume is None:
        return []
    if level == "geometric":
        return [Decision("dust", False, "-", "not at level geometric", "the truth is reported")]
    if lowest_m >= plume.onset_height_m:
        reason = f"the sensor stays above {lowest_m:.1f} m, dust begins at {plume.onset_height_m:g} m"
        return [Decision("dust", False, "-", reason, "exact")]
    reason = f"the sensor comes down to {lowest_m:.1f} m, dust begins at {plume.onset_height_m:g} m"
    if level == "statistical":
        bound = "the sheet's own echo is missing; of ground and streak the stronger is seen"
        return [Decision("dust", True, "dimming, streaks", reason, bound)]
    return [Decision("dust", True, "dimming, sheet in parcels, streaks", reason, "scattered once")]


def _switching(flight: Flight) -> list[Decision]:
    if flight.scanner.needs_ground_altitude:
        return []
    return [Decision("ground altitude", False, "-", "no switch counts its altitude from the ground", "exact")]


def _footprint(scenario: FlightScenario, pointing: Pointing, hits: Hits) -> tuple[Decision, int]:
    """How many beamlets stand for the footprint.

    One where its spectrum is narrow beside a bin, as far as that can be known before the run: over a plane or a
    sphere without objects. A spectrum of rms width s bins loses pi² s²/3 of its peak. Elsewhere the facets are unknown
    until they are hit.
    """
    asked = scenario.instrument.optics.beamlets
    if scenario.level == "geometric":
        return Decision("footprint", False, "1 beamlet", "the beam's axis is reported", "exact"), 1
    if asked == 1:
        return Decision("footprint", False, "1 beamlet", "the instrument asks for one", "as asked"), 1
    if not scenario.site.is_smooth:
        return Decision("footprint", True, f"{asked} beamlets", "slopes of the ground vary", "sampled"), asked
    spread = float(np.nanmax(spread_bins(scenario.instrument, pointing, hits).widest(), initial=0.0))
    reason = f"rms spread at most {spread:.3f} bin"
    if spread < ONE_BEAMLET_BELOW_BINS and not scenario.exact:
        bound = f"{100 * np.pi**2 / 3 * spread**2:.2g} % of the peak's power"
        return Decision("footprint", False, "1 beamlet", reason, bound), 1
    return Decision("footprint", True, f"{asked} beamlets", reason, "sampled"), asked

"""Plan of a flight: the stages computed and left out, each with its reason and error bound."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.beams.flight import Flight, sensor_height_m
from lidar_emu.beams.pointing import Pointing
from lidar_emu.errors import InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan import Decision, LeftOut, Plan, at_most, planned_faults
from lidar_emu.plan.beat_errors import BeatErrors, beat_errors
from lidar_emu.plan.expected_error import beat_variance_bin2, least_sigma
from lidar_emu.plan.ground import plan_ground, plan_objects
from lidar_emu.plan.motion import (
    MotionExtremes,
    enough_beamlets,
    largest,
    least_cosine,
    plan_curvature,
    plan_delay,
    plan_lag,
    plan_steady_motion,
    plan_unknown_curvature,
    sweep_motion,
)
from lidar_emu.plan.receiver import plan_leakage, plan_receiver, plan_unknown_ambiguity
from lidar_emu.plan.spectral_spread import Spread, spread_bins
from lidar_emu.receiver.echoes import compute_echoes
from lidar_emu.receiver.received_echoes import SPREAD_OF_ROUGHNESS, depth_nodes
from lidar_emu.receiver.returns import Echoes
from lidar_emu.receiver.skip_limits import allowed_variance_share
from lidar_emu.receiver.vibration import TONES, vibration_variances
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.trajectory import PoweredDescent
from lidar_emu.scene.ray_hits import Hits

if TYPE_CHECKING:
    from lidar_emu.beams.geometry_file import GeometryFile


ONE_BEAMLET_BELOW_BINS = 0.1
"""Rms width of the spectrum by the depth of a footprint below which one beamlet may represent it: 3 % of power."""

_SAMPLE_EVERY_S = 0.1


def plan_flight(scenario: FlightScenario, flight: Flight) -> Plan:
    """Decide each stage for the whole run, from shots sampled along the flight every tenth of a second."""
    if flight.is_live:
        return _plan_unknown(scenario, flight)
    pointing, hits = _sample_flight(flight)
    echoes = compute_echoes(scenario.instrument, scenario.site, flight, 1, pointing, hits)
    variance_bin2 = beat_variance_bin2(scenario, echoes)
    spread = spread_bins(scenario.instrument, pointing, hits)
    sampled = _sampled_beamlets(scenario, flight, echoes, spread, variance_bin2)
    errors = beat_errors(scenario, echoes)
    footprint, beamlets = _footprint(scenario, spread, variance_bin2, sampled, errors)
    effects = Plan((), receiving_lag=False, leakage=scenario.level == "reference")
    # Level geometric has none, and scatterers are computed with all of them, whatever the plan.
    if scenario.level not in ("geometric", "reference"):
        motion = sweep_motion(flight, hits, least_cosine(pointing, hits))
        effects = _plan_effects(scenario, motion, hits, echoes, variance_bin2, errors)
    decisions = (
        *_geometry(scenario, flight, pointing, hits, errors),
        _air(scenario),
        *_dust(scenario, float(np.min(sensor_height_m(pointing, hits)))),
        footprint,
        _roughness(scenario),
        *_vibration(scenario),
        *plan_receiver(scenario, echoes, errors),
        *effects.decisions,
        *planned_faults(scenario),
    )
    return replace(effects, decisions=decisions, beamlets=beamlets)


def _plan_effects(
    scenario: FlightScenario,
    motion: MotionExtremes,
    hits: Hits,
    echoes: Echoes,
    variance_bin2: FloatArray,
    errors: BeatErrors,
) -> Plan:
    waveform = scenario.instrument.waveform
    curvature, follows_chirps = plan_curvature(
        scenario, motion, least_sigma(scenario.instrument, variance_bin2)
    )
    lag, receiving_lag = plan_lag(scenario, motion, hits, errors)
    delay = plan_delay(echoes, motion, waveform.segment_time_s)
    leakage = plan_leakage(scenario, echoes, errors)
    decisions = plan_steady_motion(scenario.instrument, motion), curvature, lag, delay, leakage
    return Plan(decisions, 1, follows_chirps, receiving_lag, leakage.computed)


def _plan_unknown(scenario: FlightScenario, flight: Flight) -> Plan:
    beamlets = 1 if scenario.level == "geometric" else scenario.instrument.optics.beamlets
    kept = "the trajectory is unknown before the run"
    return Plan(
        (
            Decision("trajectory", True, "live truth", kept, "as interpolated"),
            Decision("ground", True, flight.scene.description, kept, "exact"),
            _air(scenario),
            *_dust(scenario, 0.0),
            Decision("footprint", beamlets > 1, f"{beamlets} beamlets", kept, _sampling(scenario, beamlets)),
            *_switching(flight),
            *_vibration(scenario),
            plan_unknown_curvature(scenario.instrument.waveform),
            Decision("lag of the receiving beam", True, "by the body's rate", kept, "exact"),
            Decision(
                "receiver", True, scenario.level, f"the scenario specifies level {scenario.level}", kept
            ),
            plan_unknown_ambiguity(scenario.instrument),
            *planned_faults(scenario),
        ),
        beamlets,
    )


def _sample_flight(flight: Flight) -> tuple[Pointing, Hits]:
    step = max(1, round(_SAMPLE_EVERY_S * 1e9 / flight.period_ns))
    last = flight.shot_count - 1
    shot = np.minimum(np.arange(0, last + step, step, dtype=np.int64), last)
    pointing, _ = flight.point(shot, flight.scanner.initial)
    return pointing, flight.cast(pointing)


def _geometry(
    scenario: FlightScenario, flight: Flight, pointing: Pointing, hits: Hits, errors: BeatErrors
) -> list[Decision]:
    if flight.recorded_geometry is not None:
        return [_recorded(flight.recorded_geometry)]
    return [
        _trajectory(scenario, flight),
        *_bridges(flight),
        *plan_ground(scenario, flight, pointing, hits, errors),
        *plan_objects(flight.scene, flight.ground),
        *_switching(flight),
    ]


def _recorded(geometry: GeometryFile) -> Decision:
    metadata = geometry.metadata
    how = f"{geometry.path.name}: {metadata.shots} shots of {metadata.beams} beams, {metadata.beamlets} rays each"
    reason = f"the geometry of {metadata.name} is given"
    return Decision("trajectory, ground, casting", False, how, reason, "as recorded, bit for bit", LeftOut())


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
    from lidar_emu.trajectory.powered.solution import DescentTrajectory

    descent = flight.trajectory
    assert isinstance(descent, DescentTrajectory)
    outcome, landed = descent.outcome, descent.state(np.array([descent.outcome.touchdown_s]))
    east_m, north_m, _ = landed.position_site_m[0]
    apart_m = float(flight.scene.height_m(np.array([east_m]), np.array([north_m]))[0]) - ground_m
    speed_mps = float(np.sqrt(np.sum(landed.velocity_site_mps**2)))
    how = f"{outcome.steps} steps in {outcome.end_s:.3f} s, {flight.shot_count} shots"
    reason = (
        f"cut-off at {outcome.cut_off_s:.3f} s, touchdown at {outcome.touchdown_s:.3f} s with {speed_mps:.2f} m/s, "
        f"{east_m:.1f} m east, {north_m:.1f} m north; {descent.propellant_kg:.1f} kg burnt"
    )
    bound = f"fourth order in the step; ground there {apart_m:+.2f} m off target.up_m"
    return Decision("trajectory", True, how, reason, bound)


def _air(scenario: FlightScenario) -> Decision:
    air = scenario.site.atmosphere
    if air is None or air.extinction_per_m == 0:
        return Decision("extinction", False, "vacuum", f"{scenario.site.name} has no atmosphere", "exact")
    loss_db = 20 * np.log10(np.e) * air.extinction_per_m * scenario.instrument.detection.maximum_range_m
    return Decision("extinction", True, "exp(-2αR)", f"up to {loss_db:.2f} dB at maximum range", "exact")


def _dust(scenario: FlightScenario, lowest_m: float) -> list[Decision]:
    plume, level = scenario.plume, scenario.level
    if plume is None:
        return []
    if level == "geometric":
        return [_not_at_geometric("dust")]
    reason = f"lowest sensor height {lowest_m:.1f} m, dust onset at {plume.onset_height_m:g} m"
    if lowest_m >= plume.onset_height_m:
        return [Decision("dust", False, "-", reason, "exact")]
    how = "extinction, a band of the sheet, streaks"
    return [Decision("dust", True, how, reason, "single scattering, independent records")]


def _not_at_geometric(
    stage: str, bound: str = "the ground truth is reported", left_out: LeftOut | None = None
) -> Decision:
    return Decision(stage, False, "-", "not at level geometric", bound, left_out)


def _switching(flight: Flight) -> list[Decision]:
    if flight.scanner.needs_ground_altitude:
        return []
    return [Decision("ground altitude", False, "-", "no pattern switch uses it", "exact")]


def _roughness(scenario: FlightScenario) -> Decision:
    roughness_m = scenario.site.surface.roughness_m
    if roughness_m == 0.0:
        return Decision("roughness", False, "-", "surface.roughness_m is 0", "exact")
    if scenario.level == "geometric":
        effect = LeftOut(SPREAD_OF_ROUGHNESS * roughness_m)
        return _not_at_geometric("roughness", "at nadir, beside the ground truth", effect)
    reason = f"{roughness_m:g} m scatter ranges by {at_most(SPREAD_OF_ROUGHNESS * roughness_m)} m at nadir"
    if scenario.level == "reference":
        return Decision("roughness", True, "a depth of each scatterer", reason, "exact")
    depths, _ = depth_nodes(roughness_m, scenario.instrument.waveform.range_bin_m)
    return Decision("roughness", True, f"{len(depths)} depths of each beamlet", reason, "8 % of the scatter")


def _vibration(scenario: FlightScenario) -> list[Decision]:
    if scenario.vibration is None:
        return []
    variances = vibration_variances(scenario.vibration, scenario.instrument)
    most = np.sqrt(variances.max(axis=-1)).tolist()
    if scenario.level == "geometric":
        bound = "rms of an axis, beside the ground truth"
        return [_not_at_geometric("vibration", bound, LeftOut(most[0], most[1]))]
    range_m, speed_mps, _, moving_mps = map(at_most, most)
    reason = (
        f"scatters ranges by {range_m} m, speeds by {speed_mps} m/s; the lidar moves at {moving_mps} m/s rms"
    )
    bound = "exact" if scenario.level == "reference" else "first order within a record"
    return [Decision("vibration", True, f"{TONES} tones along an axis", reason, bound)]


def _sampled_beamlets(
    scenario: FlightScenario, flight: Flight, echoes: Echoes, spread: Spread, variance_bin2: FloatArray
) -> int:
    """Choose the beamlets of a sampled footprint; a file holds the rays of one number of them."""
    optics, recorded = scenario.instrument.optics, flight.recorded_geometry
    if optics.beamlets == 1 or (recorded and recorded.metadata.beamlets == optics.beamlets):
        return optics.beamlets
    sampled: int = optics.beamlets
    if optics.speckle:
        sampled = enough_beamlets(scenario.instrument, echoes, spread, variance_bin2)
    if recorded and recorded.metadata.beamlets != sampled:
        allowed = f"must be {recorded.metadata.beamlets}, as recorded in {recorded.path}, or 1"
        raise InputError(scenario.name, "instrument.optics.beamlets", optics.beamlets, allowed)
    return sampled


def _footprint(
    scenario: FlightScenario, spread: Spread, variance_bin2: FloatArray, sampled: int, errors: BeatErrors
) -> tuple[Decision, int]:
    """Decide whether one beamlet represents the footprint, or `sampled` beamlets.

    One beamlet has the whole line by motion across the beam, and no depth. It suffices if the depth adds little to the
    scatter of the beats. That is known before the run only over a plane or a sphere without objects. The peak of a
    spectrum of rms width s bins wanders by s/√2 and is lower by pi² s²/3.
    """
    beamlets = scenario.instrument.optics.beamlets
    more = f", {sampled} for fast motion across the beam" if sampled > beamlets else ""
    if scenario.level == "geometric":
        return Decision("footprint", False, "1 beamlet", "the beam axis is reported", "exact"), 1
    if scenario.level == "reference":
        reason = "no beamlets: each scatterer has its own place"
        return Decision("footprint", True, "scatterers", reason, "5e-6 of the power"), 1
    if beamlets == 1:
        return Decision(
            "footprint", False, "1 beamlet", "the instrument has one", "as specified", LeftOut()
        ), 1
    how, limit = f"{sampled} beamlets", _sampling(scenario, sampled)
    if not scenario.site.is_smooth:
        return Decision("footprint", True, how, f"ground slopes vary{more}", limit), sampled
    speckle = scenario.instrument.optics.speckle
    # Without speckle nothing wanders, and one beamlet has no width at all.
    by_motion = spread.variance(0.0, 1.0) if speckle else 0.0
    by_depth = np.maximum(
        np.abs(spread.variance(1.0, 1.0) - by_motion), np.abs(spread.variance(1.0, -1.0) - by_motion)
    )
    share = 0.5 * by_depth / variance_bin2
    width_bins = float(np.sqrt(largest(by_depth)))
    grown = float(np.nanmax(share, initial=0.0)) if speckle else 0.0
    reason = f"its depth spreads beats by at most {width_bins:.2g} bin, {50 * grown:.2g} % of sigma"
    allowed = allowed_variance_share(scenario.left_out_share, scenario.instrument)
    enough = width_bins < ONE_BEAMLET_BELOW_BINS and grown <= allowed
    if enough and scenario.left_out_share > 0.0:
        loss = np.pi**2 / 3 * width_bins**2
        bound = f"{at_most(50 * grown)} % of sigma, {at_most(100 * loss)} % of the peak power"
        # Records of a footprint at rest have the same depth.
        effect = errors.bias(width_bins / np.sqrt(2.0) if speckle else 0.0, loss)
        return Decision("footprint", False, "1 beamlet", reason, bound, effect), 1
    return Decision("footprint", True, how, f"{reason}{more}", limit), sampled


_MISPLACED_SHARE = {7: 0.34, 19: 0.28, 37: 0.19, 61: 0.14, 91: 0.11, 127: 0.1}
"""Largest error of the light on one side of a straight line, by beamlets."""


def _sampling(scenario: FlightScenario, beamlets: int) -> str:
    """Bound of the error by a number of beamlets."""
    if beamlets == 1:
        return "as specified"
    if scenario.site.is_smooth:
        return "three moments of the light exact"
    if not scenario.site.has_edges:
        return f"up to {_MISPLACED_SHARE.get(beamlets, 0.1):g} of the light on the wrong side of a crease"
    share, apart_w = (0.07, 0.7) if beamlets < 19 else (0.03, 0.5)
    return f"{share:g} of the light at straight edges at least {apart_w:g} w apart"

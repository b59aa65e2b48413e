"""Faults of light: what they do to beams on their way out, and to echoes on their way back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.echo.echoes import BeamletHits
from lidar_emu.faults.schedule import FaultInstance
from lidar_emu.flight.flight import Flight, Pointing
from lidar_emu.flight.pointing import TRUE
from lidar_emu.fmcw.link_budget import coherent_power_w
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.vector_arrays import from_rotation_vector, rotate
from lidar_emu.scanner.model import mounting_rotation
from lidar_emu.scenario import faults as kinds
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.trajectory.state import seconds


@dataclass(frozen=True)
class _Act:
    """A fault in a block of shots."""

    fault: Any
    hit: BoolArray
    """(shots, beams) Beams that have fired and on which it acts."""
    size: FloatArray
    """(shots, 1) Part of its full size that a growing fault has."""
    beamlet_hits: BeamletHits


class LightFaults:
    """All faults of light of a scenario.

    Args:
        ordered: the faults with their schedules, in the order in which they act.
        flight: of the scenario.
    """

    def __init__(self, ordered: Sequence[FaultInstance], scenario: FlightScenario, flight: Flight) -> None:
        self._tilts = [each for each in ordered if isinstance(each.fault, kinds.Misalignment)]
        self._others = [each for each in ordered if not isinstance(each.fault, kinds.Misalignment)]
        self._scenario, self._flight = scenario, flight
        self._body_from_sensor = mounting_rotation(scenario.mounting)
        self._effects: dict[type, Callable[[Echoes, _Act], Echoes]] = {
            kinds.LaserFade: _faded,
            kinds.ReflectancePatch: _patched,
            kinds.Clutter: self._cluttered,
        }

    def tilted(self, pointing: Pointing, shot: NDArray[np.int64]) -> Pointing:
        """Where the beams go. Published directions stay."""
        for each in self._tilts:
            hit = each.hit(shot, pointing.fired)
            if hit.any():
                pointing = self._with_tilt(pointing, hit, each.grown(shot), each.fault.tilt_mrad)
        return pointing

    def lit(self, echoes: Echoes, beamlet_hits: BeamletHits, shot: NDArray[np.int64]) -> Echoes:
        """What comes back of beams whose light met the ground at `beamlet_hits`."""
        for each in self._others:
            hit = each.hit(shot, echoes.fired)
            if hit.any():
                echoes = self._effects[type(each.fault)](
                    echoes, _Act(each.fault, hit, each.grown(shot), beamlet_hits)
                )
        return echoes

    def _with_tilt(
        self, pointing: Pointing, hit: BoolArray, size: FloatArray, tilt_mrad: tuple[float, float]
    ) -> Pointing:
        vehicle = self._flight.trajectory.state(seconds(pointing.time_ns.reshape(-1)))
        sensor_rad = np.array([*tilt_mrad, 0.0]) * 1e-3
        axis_site = rotate(vehicle.site_from_body, rotate(self._body_from_sensor, sensor_rad))
        turn = from_rotation_vector(size[..., None] * axis_site.reshape(*hit.shape, 3))
        beams = pointing.beams.copy()
        beams[TRUE] = np.where(hit[..., None], rotate(turn, pointing.true_site), pointing.true_site)
        return pointing._replace(beams=beams)

    def _cluttered(self, echoes: Echoes, act: _Act) -> Echoes:
        """One more beamlet, which rides along with the sensor. It shares the beam's speckle, and its motion within a
        measurement: metres per second squared, over less than a millisecond."""
        fault, site = act.fault, self._scenario.site
        surface = site.surface.model_copy(update={"reflectance": fault.reflectance})
        power_w = coherent_power_w(self._scenario.instrument, surface, site.atmosphere, fault.range_m, 1.0)
        hit = act.hit[..., None]

        def joined(ground: FloatArray, structure: float, elsewhere: float) -> FloatArray:
            return np.concatenate([ground, np.where(hit, structure, elsewhere)], axis=-1)

        ground_w = np.where(hit, (1.0 - fault.share) * echoes.power_w, echoes.power_w)
        return replace(
            echoes,
            range_m=joined(echoes.range_m, fault.range_m, np.nan),
            closing_speed_mps=joined(echoes.closing_speed_mps, 0.0, 0.0),
            power_w=joined(ground_w, fault.share * float(power_w), 0.0),
            range_rate_mps=joined(echoes.range_rate_mps, 0.0, 0.0),
        )


def _faded(echoes: Echoes, act: _Act) -> Echoes:
    factor = 10.0 ** (-act.fault.loss_db * act.size / 10.0)
    return replace(echoes, power_w=np.where(act.hit, factor, 1.0)[..., None] * echoes.power_w)


def _patched(echoes: Echoes, act: _Act) -> Echoes:
    """Beamlets that meet the ground within the disc."""
    start_m, ray, hits = act.beamlet_hits
    east_m, north_m = (start_m[..., k] + hits.range_m * ray[..., k] for k in range(2))
    away_m = np.hypot(east_m - act.fault.centre_m[0], north_m - act.fault.centre_m[1])
    # What clutter and dust have added lies behind the beamlets; dust that is seen instead of the ground has its place.
    of_ground = echoes.range_m[..., : away_m.shape[-1]] == hits.range_m
    within = act.hit[..., None] & of_ground & (away_m <= act.fault.radius_m)
    # Of a place that is wholly black there is no echo to change.
    ratio = np.divide(
        act.fault.reflectance,
        hits.reflectance,
        out=np.ones(within.shape),
        where=within & (hits.reflectance > 0.0),
    )
    power_w = echoes.power_w.copy()
    power_w[..., : ratio.shape[-1]] *= ratio
    return replace(echoes, power_w=power_w)

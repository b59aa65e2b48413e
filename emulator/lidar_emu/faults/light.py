"""Faults of light: effects on the direction of beams and on the power of echoes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.patterns import mounting_rotation
from lidar_emu.beams.pointing import BeamVectors, ChirpBeams, Pointing
from lidar_emu.echo.echoes import BeamletHits
from lidar_emu.faults.schedule import FaultInstance
from lidar_emu.fmcw.link_budget import coherent_power_w
from lidar_emu.fmcw.returns import DUST_W, Echoes
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.vector_arrays import from_rotation_vector, rotate
from lidar_emu.scenario.faults import beams as kinds
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.trajectory.profile import seconds


@dataclass(frozen=True)
class _ActiveLightFault:
    fault: Any
    affected: BoolArray
    """(shots, beams) Fired beams on which the fault acts."""
    ramp: FloatArray
    """(shots, 1) Fraction of the full magnitude."""
    beamlet_hits: BeamletHits


class LightFaults:
    """All faults of light of a scenario.

    Args:
        faults: faults in the order in which they act.
        scenario: scenario with the faults.
        flight: flight of the scenario.
    """

    def __init__(self, faults: Sequence[FaultInstance], scenario: FlightScenario, flight: Flight) -> None:
        self._misalignments = [each for each in faults if isinstance(each.fault, kinds.Misalignment)]
        self._echo_faults = [each for each in faults if not isinstance(each.fault, kinds.Misalignment)]
        self._scenario, self._flight = scenario, flight
        self._body_from_sensor = mounting_rotation(scenario.mounting)
        self._effects: dict[type, Callable[[Echoes, _ActiveLightFault], Echoes]] = {
            kinds.LaserFade: _faded,
            kinds.ReflectancePatch: _patched,
            kinds.Clutter: self._cluttered,
        }

    def tilted(self, pointing: Pointing, shot: NDArray[np.int64]) -> Pointing:
        """Pointing with misaligned true directions; published directions are unchanged."""
        for each in self._misalignments:
            affected = each.affected_beams(shot, pointing.fired)
            if affected.any():
                pointing = self._with_tilt(pointing, affected, each.ramp(shot), each.fault.tilt_mrad)
        return pointing

    def modified(self, echoes: Echoes, beamlet_hits: BeamletHits, shot: NDArray[np.int64]) -> Echoes:
        """Echoes after faults, from beams whose light hit the ground at `beamlet_hits`."""
        for each in self._echo_faults:
            affected = each.affected_beams(shot, echoes.fired)
            if affected.any():
                active = _ActiveLightFault(each.fault, affected, each.ramp(shot), beamlet_hits)
                echoes = self._effects[type(each.fault)](echoes, active)
        return echoes

    def _with_tilt(
        self, pointing: Pointing, affected: BoolArray, ramp: FloatArray, tilt_mrad: tuple[float, float]
    ) -> Pointing:
        sensor_rad = np.array([*tilt_mrad, 0.0]) * 1e-3
        axis_body_rad = rotate(self._body_from_sensor, sensor_rad)

        def tilt(true_site: FloatArray, time_s: FloatArray) -> None:
            vehicle = self._flight.trajectory.state(time_s.reshape(-1))
            axis_site = rotate(vehicle.site_from_body, axis_body_rad).reshape(true_site.shape)
            turn = from_rotation_vector(ramp[..., None] * axis_site)
            true_site[:] = np.where(affected[..., None], rotate(turn, true_site), true_site)

        tilted = pointing._replace(beams=pointing.beams.copy(), at_chirps=pointing.at_chirps.copy())
        tilt(BeamVectors(*tilted.beams).true, seconds(pointing.time_ns))
        if tilted.at_chirps.size:
            tilt(ChirpBeams(*tilted.at_chirps).true, self._flight.chirp_times_s(pointing))
        return tilted

    def _cluttered(self, echoes: Echoes, active: _ActiveLightFault) -> Echoes:
        """Echoes with one more beamlet, which moves with the sensor.

        The beamlet shares the speckle of the beam and its acceleration, which matters little within a millisecond.
        """
        fault, site = active.fault, self._scenario.site
        surface = site.surface.model_copy(update={"reflectance": fault.reflectance})
        power_w = coherent_power_w(self._scenario.instrument, surface, site.atmosphere, fault.range_m, 1.0)
        affected = active.affected[..., None]

        def joined(ground: FloatArray, structure: float, elsewhere: float) -> FloatArray:
            return np.concatenate([ground, np.where(affected, structure, elsewhere)], axis=-1)

        ground_w = np.where(affected, (1.0 - fault.share) * echoes.power_w, echoes.power_w)
        return echoes._replace(
            range_m=joined(echoes.range_m, fault.range_m, np.nan),
            closing_speed_mps=joined(echoes.closing_speed_mps, 0.0, 0.0),
            power_w=joined(ground_w, fault.share * float(power_w), 0.0),
            range_rate_mps=joined(echoes.range_rate_mps, 0.0, 0.0),
        )


def _faded(echoes: Echoes, active: _ActiveLightFault) -> Echoes:
    factor = 10.0 ** (-active.fault.loss_db * active.ramp / 10.0)
    share = np.where(active.affected, factor, 1.0)[..., None]
    dust = echoes.dust.copy()
    dust[..., DUST_W : DUST_W + 1] *= share if dust.size else 1.0
    return echoes._replace(power_w=share * echoes.power_w, dust=dust)


def _patched(echoes: Echoes, active: _ActiveLightFault) -> Echoes:
    start_m, ray, hits = active.beamlet_hits
    east_m, north_m = (start_m[..., k] + hits.range_m * ray[..., k] for k in range(2))
    away_m = np.hypot(east_m - active.fault.centre_m[0], north_m - active.fault.centre_m[1])
    # Clutter and dust add beamlets behind the ground's; a beamlet whose echo comes from dust has another range.
    from_ground = echoes.range_m[..., : away_m.shape[-1]] == hits.range_m
    within = active.affected[..., None] & from_ground & (away_m <= active.fault.radius_m)
    # Ground with reflectance 0 returns no echo that could be scaled.
    ratio = np.divide(
        active.fault.reflectance,
        hits.reflectance,
        out=np.ones(within.shape),
        where=within & (hits.reflectance > 0.0),
    )
    power_w = echoes.power_w.copy()
    power_w[..., : ratio.shape[-1]] *= ratio
    return echoes._replace(power_w=power_w)

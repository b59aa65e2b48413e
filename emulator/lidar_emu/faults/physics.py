"""Faults of light and receiver, applied within the model of a flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.patterns import mounting_rotation
from lidar_emu.beams.pointing import BeamVectors, ChirpBeams, Pointing
from lidar_emu.errors import Finding, InputError
from lidar_emu.faults.schedule import FaultInstance, FaultOccurrence
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.vector_arrays import from_rotation_vector, rotate
from lidar_emu.receiver.build_level import Level
from lidar_emu.receiver.echoes import BeamletHits
from lidar_emu.receiver.link_budget import coherent_power_w
from lidar_emu.receiver.receiver import FmcwReceiver
from lidar_emu.receiver.receiver_faults import (
    decimated,
    noisier,
    without_segments,
)
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import DUST_W, Echoes, Returns
from lidar_emu.scenario.effects_by_level import has_effect, levels_with
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


class FaultyReceivers:
    """A receiver with faults.

    All receivers share the kernels and the random streams: faults do not change the measurement of unaffected beams.

    Args:
        faults: faults in the order in which they act.
        scenario: scenario with the faults.
        sound: receiver without faults.
    """

    def __init__(
        self, faults: Sequence[FaultInstance], scenario: FlightScenario, sound: FmcwReceiver
    ) -> None:
        self._faults = faults
        self._scenario = scenario
        self._receivers = {0: sound}
        # Built before the run for each single fault; combinations are built when they first occur.
        for bit in range(len(faults)):
            self._receiver(1 << bit)

    def __call__(self, echoes: Echoes, shot: NDArray[np.int64]) -> Returns:
        """Returns of echoes (shots, beams, beamlets) of the shots with these numbers, (shots,)."""
        acting = np.zeros(echoes.fired.shape, dtype=np.int64)
        for bit, each in enumerate(self._faults):
            acting |= each.affected_beams(shot, echoes.fired).astype(np.int64) << bit
        returns = self._receivers[0](self._only(echoes, acting == 0), shot)
        for which in np.unique(acting[acting > 0]).tolist():
            here = acting == which
            returns = _merged(returns, self._receiver(which)(self._only(echoes, here), shot), here)
        return returns

    def _only(self, echoes: Echoes, beams: BoolArray) -> Echoes:
        return echoes if beams.all() else echoes._replace(fired=echoes.fired & beams)

    def _receiver(self, acting: int) -> FmcwReceiver:
        if acting not in self._receivers:
            model = self._receivers[0].model
            for bit, each in enumerate(self._faults):
                if acting >> bit & 1:
                    model = _faulty(model, each.fault, self._scenario)
            self._receivers[acting] = FmcwReceiver(model, self._scenario.seed)
        return self._receivers[acting]


def _faulty(model: ReceiverModel, fault: Any, scenario: FlightScenario) -> ReceiverModel:
    match fault:
        case kinds.MissingSegment():
            return without_segments(model, fault.segments)
        case kinds.WrongBranch():
            return model._replace(opposite_doppler_sign=True)
        case kinds.Alias():
            return decimated(model, fault.decimation)
        case kinds.FalseAlarms():
            return noisier(model, scenario.instrument.detection, fault.noise_db)
    raise ValueError(f"{fault} is not a fault of the receiver")


def _merged(returns: Returns, others: Returns, where: BoolArray) -> Returns:
    columns: dict[str, Any] = {}
    for name in (field.name for field in fields(Returns)):
        own, other = getattr(returns, name), getattr(others, name)
        columns[name] = np.where(where.reshape(*where.shape, *(1,) * (own.ndim - 2)), other, own)
    return Returns(**columns)


_MAXIMUM_RECEIVER_FAULTS = 32


class PhysicsFaults:
    """All faults of light and receiver of a scenario.

    Args:
        faults: faults with their indices in the scenario's list.
        scenario: scenario with the faults.
        flight: flight of the scenario.
        level: receiver without faults.

    Raises:
        InputError: a fault does not apply to this level or this ground, or there are too many.
    """

    def __init__(
        self,
        faults: Sequence[tuple[int, kinds.LightFault | kinds.ReceiverFault]],
        scenario: FlightScenario,
        flight: Flight,
        level: Level,
    ) -> None:
        beam_count = flight.scanner.beam_count
        for index, fault in faults:
            _check(scenario, index, fault)
        self._faults = [
            FaultInstance(index, fault, scenario.seed, scenario.timing.period_ns, beam_count)
            for index, fault in faults
        ]
        receivers = [each for each in self._faults if isinstance(each.fault, kinds.ReceiverFault)]
        if len(receivers) > _MAXIMUM_RECEIVER_FAULTS:
            found = Finding(f"{len(receivers)} faults of the receiver")
            raise InputError(scenario.name, "faults", found, f"use at most {_MAXIMUM_RECEIVER_FAULTS}")
        self._scenario, self._flight = scenario, flight
        self._body_from_sensor = mounting_rotation(scenario.mounting)
        self._effects: dict[type, Callable[[Echoes, _ActiveLightFault], Echoes]] = {
            kinds.LaserFade: _faded,
            kinds.ReflectancePatch: _patched,
            kinds.Clutter: self._cluttered,
        }
        self._misalignments = [each for each in self._faults if isinstance(each.fault, kinds.Misalignment)]
        self._echo_faults = [each for each in self._faults if type(each.fault) in self._effects]
        self.level = level
        if receivers:
            # `_check` admits their faults at the levels of this receiver alone.
            assert isinstance(level, FmcwReceiver)
            self.level = FaultyReceivers(receivers, scenario, level)

    def may_act(self, shot: int) -> bool:
        """Whether the shot is in the window of a fault."""
        schedules = (each.schedule for each in self._faults)
        return any(each.has_begun(shot) and not each.has_ended(shot) for each in schedules)

    def tilted(self, pointing: Pointing, shot: NDArray[np.int64]) -> Pointing:
        """Pointing with misaligned true directions; published directions are unchanged."""
        for each in self._misalignments:
            affected = each.affected_beams(shot, pointing.fired)
            if affected.any():
                pointing = self._with_tilt(pointing, affected, each.ramp(shot), each.fault.tilt_mrad)
        return pointing

    def modified(self, echoes: Echoes, beamlet_hits: BeamletHits, shot: NDArray[np.int64]) -> Echoes:
        """Echoes after faults of light, from beams whose light hit the ground at `beamlet_hits`."""
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

    def occurrences(self, shot: NDArray[np.int64], fired: BoolArray) -> list[FaultOccurrence]:
        """Occurrences of faults in consecutive shots, whose fired beams are `fired`, (shots, beams)."""
        return [
            FaultOccurrence(
                int(shot[row]), each.index, each.fault.kind, tuple(np.flatnonzero(beams).tolist())
            )
            for each in self._faults
            for row, beams in enumerate(each.affected_beams(shot, fired))
            if beams.any()
        ]


def _check(scenario: FlightScenario, index: int, fault: Any) -> None:
    effect = f"fault {fault.kind}"
    if not has_effect(scenario, effect):
        found = Finding(f"{fault.kind} at level {scenario.level}")
        remedy = f"use level {levels_with(effect)}"
        raise InputError(scenario.name, f"faults.{index}.kind", found, remedy)
    if isinstance(fault, kinds.ReflectancePatch) and scenario.site.surface.reflectance == 0:
        found = Finding("a reflectance_patch on black ground")
        remedy = "use a site.surface.reflectance above 0"
        raise InputError(scenario.name, f"faults.{index}.kind", found, remedy)

"""Faults of beams: effects on measurements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lidar_emu.faults.schedule import FaultInstance, FaultOccurrence
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.receiver.returns import REPORT_COLUMNS, Reason
from lidar_emu.scenario.faults import beams as kinds

Row = NDArray[Any]
_Held = TypeVar("_Held")


def hold(values: NDArray[Any], renewed: BoolArray, before: Row | None) -> tuple[NDArray[Any], Row]:
    """Hold the last renewed value of each beam, shot by shot.

    Args:
        values: (shots, beams) values of consecutive shots.
        renewed: (shots, beams) where a value replaces the held one.
        before: (1, beams) values held before the first shot; None: none yet, the first shot's values are taken.

    Returns:
        (shots, beams) values held at each shot, and (1, beams) values held after the last.
    """
    if renewed.all():
        return values, values[-1:]
    stacked = np.concatenate([values[:1] if before is None else before, values])
    row = np.where(renewed, np.arange(1, len(values) + 1)[:, None], 0)
    held = np.take_along_axis(stacked, np.maximum.accumulate(row, axis=0), axis=0)
    return held, held[-1:]


def extended(held: tuple[_Held, ...], initial: tuple[_Held, ...]) -> tuple[_Held, ...]:
    """State of the first faults of a list, extended by the initial state of the faults added behind them."""
    return held + initial[len(held) :]


Held = dict[str, Row]
"""Values that a fault holds from shot to shot: rows (1, beams) by their names in `Measurement`."""

_FLAGS = tuple(name for name, column in REPORT_COLUMNS.items() if column.dtype == "?")
_VALUES = {
    "range": (("range_m", "range_valid"),),
    "closing_speed": (("closing_speed_mps", "speed_valid"),),
    "both": (("range_m", "range_valid"), ("closing_speed_mps", "speed_valid")),
}
_VALUE_DRAW = 1


@dataclass(frozen=True)
class _ActiveBeamFault:
    instance: FaultInstance
    affected: BoolArray
    """(shots, beams) Fired beams on which the fault acts."""
    held: Held | None
    """Values held before the block; None: none yet."""

    @property
    def fault(self) -> Any:
        return self.instance.fault

    def with_columns(self, block: Measurement, **columns: Any) -> Measurement:
        """Block with these values where the fault acts."""
        if not self.affected.any():
            return block
        chosen: dict[str, Any] = {}
        for name, values in columns.items():
            own = getattr(block, name)
            chosen[name] = np.where(self.affected, values, own).astype(own.dtype)
        return replace(block, **chosen)


class BeamFaults:
    """All faults of beams of a scenario.

    Args:
        faults: faults with their indices in the scenario's list.
        seed: seed of the run.
        period_ns: shot period.
        beam_count: beams of a shot.
    """

    def __init__(
        self,
        faults: Sequence[tuple[int, kinds.BeamFault]],
        seed: int,
        period_ns: int,
        beam_count: int,
    ) -> None:
        self._faults = [FaultInstance(index, fault, seed, period_ns, beam_count) for index, fault in faults]
        self.initial: tuple[Held | None, ...] = (None,) * len(self._faults)
        """State before shot 0: values held by each fault."""

    def extended(self, held: tuple[Held | None, ...]) -> tuple[Held | None, ...]:
        """State of the first of these faults, extended by the initial state of the faults added behind them."""
        return extended(held, self.initial)

    def apply(
        self, block: Measurement, held: tuple[Held | None, ...]
    ) -> tuple[Measurement, tuple[Held | None, ...], list[FaultOccurrence]]:
        """Apply the faults to consecutive shots; `point_site_m` is left to the caller.

        Returns:
            The measurement after faults, the values held after it, and the occurrences of faults.
        """
        occurrences: list[FaultOccurrence] = []
        after: list[Held | None] = []
        for instance, before in zip(self._faults, held, strict=True):
            effect = _EFFECTS[type(instance.fault)]
            holds = effect in _HOLDING
            may_act = holds or instance.schedule.has_begun(int(block.shot[-1]))
            if not may_act or instance.schedule.has_ended(int(block.shot[0])):
                after.append(None)
                continue
            active = _ActiveBeamFault(instance, _affected(instance, block), before)
            changed, holding = effect(block, active) if holds or active.affected.any() else (block, None)
            after.append(holding)
            for row in np.flatnonzero(active.affected.any(axis=1)).tolist():
                beams = tuple(np.flatnonzero(active.affected[row]).tolist())
                shot, kind = int(block.shot[row]), instance.fault.kind
                occurrences.append(FaultOccurrence(shot, instance.index, kind, beams))
            block = changed
        return block, tuple(after), occurrences


def _affected(instance: FaultInstance, block: Measurement) -> BoolArray:
    fault = instance.fault
    if isinstance(fault, kinds.SwappedBeams):
        both = instance.schedule.active_shots(block.shot) & block.fired[:, list(fault.beams)].all(axis=1)
        affected = np.zeros_like(block.fired)
        affected[:, list(fault.beams)] = both[:, None]
        return affected
    affected = instance.affected_beams(block.shot, block.fired)
    return affected & _ELIGIBLE[type(fault)](block, fault) if type(fault) in _ELIGIBLE else affected


_Result = tuple[Measurement, Held | None]


def _dropout(block: Measurement, active: _ActiveBeamFault) -> _Result:
    nothing: dict[str, Any] = {name: column.missing_value for name, column in REPORT_COLUMNS.items()}
    why = dict.fromkeys(("reason", "second_reason"), Reason.BELOW_THRESHOLD)
    return active.with_columns(block, **nothing | why), None


def _stuck(block: Measurement, active: _ActiveBeamFault) -> _Result:
    columns, holding = {}, {}
    for value, flag in _VALUES[active.fault.value]:
        valid = getattr(block, flag)
        own = np.where(valid, getattr(block, value), np.nan)
        before = active.held[value] if active.held else None
        held, holding[value] = hold(own, valid & ~active.affected, before)
        columns[value] = np.where(valid & ~np.isnan(held), held, getattr(block, value))
    return active.with_columns(block, **columns), holding


def _frozen(block: Measurement, active: _ActiveBeamFault) -> _Result:
    columns, holding = {}, {}
    for name in REPORT_COLUMNS:
        before = active.held[name] if active.held else None
        columns[name], holding[name] = hold(getattr(block, name), block.fired & ~active.affected, before)
    return active.with_columns(block, **columns), holding


def _with_errors(block: Measurement, active: _ActiveBeamFault, range_m: Any, speed_mps: Any) -> _Result:
    erroneous_m = np.maximum(0.0, block.range_m + range_m)
    return active.with_columns(
        block, range_m=erroneous_m, closing_speed_mps=block.closing_speed_mps + speed_mps
    ), None


def _bias(block: Measurement, active: _ActiveBeamFault) -> _Result:
    ramp = active.instance.ramp(block.shot)
    return _with_errors(block, active, ramp * active.fault.range_m, ramp * active.fault.closing_speed_mps)


def _scale(block: Measurement, active: _ActiveBeamFault) -> _Result:
    ramp, fault = active.instance.ramp(block.shot), active.fault
    range_m = block.range_m * (1 + ramp * (fault.range_factor - 1))
    speed_mps = block.closing_speed_mps * (1 + ramp * (fault.closing_speed_factor - 1))
    return active.with_columns(block, range_m=range_m, closing_speed_mps=speed_mps), None


def _drift(block: Measurement, active: _ActiveBeamFault) -> _Result:
    elapsed_s = active.instance.schedule.elapsed_s(block.shot)[:, None]
    return _with_errors(
        block, active, elapsed_s * active.fault.range_mps, elapsed_s * active.fault.closing_speed_mps2
    )


def _noise(block: Measurement, active: _ActiveBeamFault) -> _Result:
    errors = active.instance.ramp(block.shot)[..., None] * active.instance.stream.normals(
        block.shot, block.beam_count, _VALUE_DRAW
    )
    fault = active.fault
    return _with_errors(
        block, active, errors[..., 0] * fault.range_m, errors[..., 1] * fault.closing_speed_mps
    )


def _outlier(block: Measurement, active: _ActiveBeamFault) -> _Result:
    fraction = active.instance.stream.uniforms(block.shot, block.beam_count, _VALUE_DRAW)
    columns: dict[str, Any] = {"range_m": _between(active.fault.range_m, fraction[..., 0])}
    if active.fault.closing_speed_mps is not None:
        columns["closing_speed_mps"] = _between(active.fault.closing_speed_mps, fraction[..., 1])
    return _claimed_valid(block, active, columns), None


def _between(interval: kinds.Interval, fraction: FloatArray) -> FloatArray:
    return interval[0] + (interval[1] - interval[0]) * fraction


def _claimed_valid(block: Measurement, active: _ActiveBeamFault, columns: dict[str, Any]) -> Measurement:
    flags = dict.fromkeys(_FLAGS, True)
    returns = np.maximum(1, block.returns)
    return active.with_columns(block, **columns, **flags, reason=Reason.VALID, segments=7, returns=returns)


def _wrong_sign(block: Measurement, active: _ActiveBeamFault) -> _Result:
    return active.with_columns(block, closing_speed_mps=-block.closing_speed_mps), None


def _swapped_beams(block: Measurement, active: _ActiveBeamFault) -> _Result:
    columns: dict[str, NDArray[Any]] = {}
    a, b = active.fault.beams
    for name in REPORT_COLUMNS:
        columns[name] = getattr(block, name).copy()
        columns[name][:, [a, b]] = columns[name][:, [b, a]]
    return active.with_columns(block, **columns), None


def _false_valid(block: Measurement, active: _ActiveBeamFault) -> _Result:
    fault = active.fault
    columns = {"range_m": fault.range_m, "closing_speed_mps": fault.closing_speed_mps}
    return _claimed_valid(block, active, columns), None


def _false_invalid(block: Measurement, active: _ActiveBeamFault) -> _Result:
    return active.with_columns(
        block, range_valid=False, speed_valid=False, reason=Reason.BELOW_THRESHOLD
    ), None


def _is_valid(block: Measurement, _: Any = None) -> BoolArray:
    return block.range_valid | block.speed_valid


_EFFECTS: dict[type, Callable[[Measurement, _ActiveBeamFault], _Result]] = {
    kinds.Dropout: _dropout,
    kinds.Stuck: _stuck,
    kinds.Frozen: _frozen,
    kinds.Bias: _bias,
    kinds.Scale: _scale,
    kinds.Drift: _drift,
    kinds.Noise: _noise,
    kinds.Outlier: _outlier,
    kinds.WrongSign: _wrong_sign,
    kinds.SwappedBeams: _swapped_beams,
    kinds.FalseValid: _false_valid,
    kinds.FalseInvalid: _false_invalid,
}
_HOLDING = (_stuck, _frozen)
_ELIGIBLE: dict[type, Callable[[Measurement, Any], BoolArray]] = {
    **dict.fromkeys(
        (kinds.Stuck, kinds.Bias, kinds.Scale, kinds.Drift, kinds.Noise, kinds.FalseInvalid), _is_valid
    ),
    kinds.Outlier: lambda block, fault: block.speed_valid | (fault.closing_speed_mps is not None),
    kinds.WrongSign: lambda block, _: block.speed_valid,
    kinds.FalseValid: lambda block, _: ~_is_valid(block),
}
"""Beams on which a fault can act; kinds that are not listed act on any fired beam."""

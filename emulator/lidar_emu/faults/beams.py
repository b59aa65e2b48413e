"""Faults of beams: what they make of a measurement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.faults.held_values import Row, hold, resumed
from lidar_emu.faults.schedule import FaultInstance, FaultOccurrence
from lidar_emu.fmcw.reasons import Reason
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scenario import faults as kinds

Held = dict[str, Row]
"""What one fault carries from shot to shot: rows (1, beams) by their names in `Measurement`."""

_FLOATS = (
    "range_m",
    "closing_speed_mps",
    "snr_db",
    "residual_mps",
    "sigma_range_m",
    "sigma_speed_mps",
    "second_range_m",
)
_FLAGS = ("range_valid", "speed_valid", "sign_resolved")
_REPORTED = (*_FLOATS, *_FLAGS, "reason", "segments", "returns")
_VALUES = {
    "range": (("range_m", "range_valid"),),
    "closing_speed": (("closing_speed_mps", "speed_valid"),),
    "both": (("range_m", "range_valid"), ("closing_speed_mps", "speed_valid")),
}
_VALUE_DRAW = 1


@dataclass(frozen=True)
class _Act:
    """A fault in a block of shots."""

    ordered: FaultInstance
    hit: BoolArray
    """(shots, beams) Beams that have fired and on which the fault acts."""
    held: Held | None
    """From before the block; None: nothing yet."""

    @property
    def fault(self) -> Any:
        """What the scenario says."""
        return self.ordered.fault

    def size(self, block: Measurement) -> FloatArray:
        """(shots, 1) Part of its full size that a growing fault has."""
        return self.ordered.grown(block.shot)

    def with_columns(self, block: Measurement, **columns: Any) -> Measurement:
        """The block with these values where the fault acts."""
        if not self.hit.any():
            return block
        chosen: dict[str, Any] = {}
        for name, values in columns.items():
            own = getattr(block, name)
            chosen[name] = np.where(self.hit, values, own).astype(own.dtype)
        return replace(block, **chosen)


class BeamFaults:
    """All faults of beams of a scenario.

    Args:
        numbered: the faults, with their places in the scenario's list.
        seed: of the run.
        period_ns: from shot to shot.
        beam_count: beams of a shot.
    """

    def __init__(
        self,
        numbered: Sequence[tuple[int, kinds.BeamFault]],
        seed: int,
        period_ns: int,
        beam_count: int,
    ) -> None:
        self._faults = [
            FaultInstance(number, fault, seed, period_ns, beam_count) for number, fault in numbered
        ]
        self.initial: tuple[Held | None, ...] = (None,) * len(self._faults)
        """What is carried before shot 0."""

    def resumed(self, held: tuple[Held | None, ...]) -> tuple[Held | None, ...]:
        """What fewer of these faults have carried so far, for all of them."""
        return resumed(held, self.initial)

    def apply(
        self, block: Measurement, held: tuple[Held | None, ...]
    ) -> tuple[Measurement, tuple[Held | None, ...], list[FaultOccurrence]]:
        """What becomes of consecutive shots, but for `point_site_m`; what is carried on; and which faults acted."""
        injected: list[FaultOccurrence] = []
        after: list[Held | None] = []
        for ordered, before in zip(self._faults, held, strict=True):
            effect = _EFFECTS[type(ordered.fault)]
            carries = effect in _CARRY
            due = carries or ordered.schedule.begins_by(int(block.shot[-1]))
            if not due or ordered.schedule.is_over(int(block.shot[0])):
                after.append(None)
                continue
            act = _Act(ordered, _hit(ordered, block), before)
            changed, carried = effect(block, act) if carries or act.hit.any() else (block, None)
            after.append(carried)
            for row in np.flatnonzero(act.hit.any(axis=1)).tolist():
                beams = tuple(np.flatnonzero(act.hit[row]).tolist())
                injected.append(
                    FaultOccurrence(int(block.shot[row]), ordered.number, ordered.fault.kind, beams)
                )
            block = changed
        return block, tuple(after), injected


def _hit(ordered: FaultInstance, block: Measurement) -> BoolArray:
    """(shots, beams) Beams on which a fault acts."""
    fault = ordered.fault
    if isinstance(fault, kinds.SwappedBeams):
        both = ordered.schedule.shots(block.shot) & block.fired[:, list(fault.beams)].all(axis=1)
        hit = np.zeros_like(block.fired)
        hit[:, list(fault.beams)] = both[:, None]
        return hit
    hit = ordered.hit(block.shot, block.fired)
    return hit & _HITS[type(fault)](block, fault) if type(fault) in _HITS else hit


_Result = tuple[Measurement, Held | None]


def _dropout(block: Measurement, act: _Act) -> _Result:
    nothing: dict[str, Any] = {**dict.fromkeys(_FLOATS, np.nan), **dict.fromkeys(_FLAGS, False)}
    reason = Reason.BELOW_THRESHOLD
    return act.with_columns(block, **nothing, reason=reason, segments=0, returns=0), None


def _stuck(block: Measurement, act: _Act) -> _Result:
    columns, carried = {}, {}
    for value, flag in _VALUES[act.fault.value]:
        valid = getattr(block, flag)
        own = np.where(valid, getattr(block, value), np.nan)
        before = act.held[value] if act.held else None
        held, carried[value] = hold(own, valid & ~act.hit, before)
        columns[value] = np.where(valid & ~np.isnan(held), held, getattr(block, value))
    return act.with_columns(block, **columns), carried


def _frozen(block: Measurement, act: _Act) -> _Result:
    columns, carried = {}, {}
    for name in _REPORTED:
        before = act.held[name] if act.held else None
        columns[name], carried[name] = hold(getattr(block, name), block.fired & ~act.hit, before)
    return act.with_columns(block, **columns), carried


def _with_errors(block: Measurement, act: _Act, range_m: Any, speed_mps: Any) -> _Result:
    erroneous_m = np.maximum(0.0, block.range_m + range_m)
    return act.with_columns(
        block, range_m=erroneous_m, closing_speed_mps=block.closing_speed_mps + speed_mps
    ), None


def _bias(block: Measurement, act: _Act) -> _Result:
    size = act.size(block)
    return _with_errors(block, act, size * act.fault.range_m, size * act.fault.closing_speed_mps)


def _scale(block: Measurement, act: _Act) -> _Result:
    size, fault = act.size(block), act.fault
    range_m = block.range_m * (1 + size * (fault.range_factor - 1))
    speed_mps = block.closing_speed_mps * (1 + size * (fault.closing_speed_factor - 1))
    return act.with_columns(block, range_m=range_m, closing_speed_mps=speed_mps), None


def _drift(block: Measurement, act: _Act) -> _Result:
    since_s = act.ordered.schedule.since_s(block.shot)[:, None]
    return _with_errors(block, act, since_s * act.fault.range_mps, since_s * act.fault.closing_speed_mps2)


def _noise(block: Measurement, act: _Act) -> _Result:
    errors = act.size(block)[..., None] * act.ordered.stream.normals(
        block.shot, block.beam_count, _VALUE_DRAW
    )
    fault = act.fault
    return _with_errors(block, act, errors[..., 0] * fault.range_m, errors[..., 1] * fault.closing_speed_mps)


def _outlier(block: Measurement, act: _Act) -> _Result:
    place = act.ordered.stream.uniforms(block.shot, block.beam_count, _VALUE_DRAW)
    columns: dict[str, Any] = {"range_m": _between(act.fault.range_m, place[..., 0])}
    if act.fault.closing_speed_mps is not None:
        columns["closing_speed_mps"] = _between(act.fault.closing_speed_mps, place[..., 1])
    return _claimed_valid(block, act, columns), None


def _between(interval: kinds.Interval, place: FloatArray) -> FloatArray:
    return interval[0] + (interval[1] - interval[0]) * place


def _claimed_valid(block: Measurement, act: _Act, columns: dict[str, Any]) -> Measurement:
    flags = dict.fromkeys(_FLAGS, True)
    returns = np.maximum(1, block.returns)
    return act.with_columns(block, **columns, **flags, reason=Reason.VALID, segments=7, returns=returns)


def _wrong_sign(block: Measurement, act: _Act) -> _Result:
    return act.with_columns(block, closing_speed_mps=-block.closing_speed_mps), None


def _swapped_beams(block: Measurement, act: _Act) -> _Result:
    columns: dict[str, NDArray[Any]] = {}
    a, b = act.fault.beams
    for name in _REPORTED:
        columns[name] = getattr(block, name).copy()
        columns[name][:, [a, b]] = columns[name][:, [b, a]]
    return act.with_columns(block, **columns), None


def _false_valid(block: Measurement, act: _Act) -> _Result:
    fault = act.fault
    columns = {"range_m": fault.range_m, "closing_speed_mps": fault.closing_speed_mps}
    return _claimed_valid(block, act, columns), None


def _false_invalid(block: Measurement, act: _Act) -> _Result:
    return act.with_columns(block, range_valid=False, speed_valid=False, reason=Reason.BELOW_THRESHOLD), None


def _is_valid(block: Measurement, fault: Any = None) -> BoolArray:  # noqa: ARG001
    return block.range_valid | block.speed_valid


_EFFECTS: dict[type, Callable[[Measurement, _Act], _Result]] = {
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
_CARRY = (_stuck, _frozen)
_HITS: dict[type, Callable[[Measurement, Any], BoolArray]] = {
    kinds.Stuck: _is_valid,
    kinds.Bias: _is_valid,
    kinds.Scale: _is_valid,
    kinds.Drift: _is_valid,
    kinds.Noise: _is_valid,
    kinds.Outlier: lambda block, fault: block.speed_valid | (fault.closing_speed_mps is not None),
    kinds.WrongSign: lambda block, _: block.speed_valid,
    kinds.FalseValid: lambda block, _: ~_is_valid(block),
    kinds.FalseInvalid: _is_valid,
}
"""Beams on which a fault can act; those that are not here act on any that fired."""

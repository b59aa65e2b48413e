"""Faults of packet contents: clock, counter and units. The measurement and its timing are not affected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.device.state import LAST_NS
from lidar_emu.faults.beams import Row, hold
from lidar_emu.faults.schedule import FaultOccurrence, FaultSchedule
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.random_streams import RandomStream, fault_purpose
from lidar_emu.receiver.returns import REPORT_COLUMNS
from lidar_emu.scenario.faults import packets as kinds
from lidar_protocol import CanFrame, DecodeError, Interface
from lidar_protocol.can_frames import Address, addresses
from lidar_protocol.layout import Layout
from lidar_protocol.packet import seal, unseal

_IN_METRES = tuple(name for name, column in REPORT_COLUMNS.items() if column.unit in ("m", "m/s"))

ContentState = tuple[Row | None, ...]
"""For each fault, the last shot number before it acted."""


class ContentFaults:
    """All faults of packet contents of a scenario.

    Args:
        faults: faults with their indices in the scenario's list.
        seed: seed of the run.
        period_ns: shot period.
    """

    def __init__(self, faults: Sequence[tuple[int, kinds.ContentFault]], seed: int, period_ns: int) -> None:
        self._faults = [
            (index, fault, FaultSchedule(fault, RandomStream(seed, fault_purpose(index)), period_ns))
            for index, fault in faults
        ]
        self.initial: ContentState = (None,) * len(self._faults)
        """State before shot 0."""

    def apply(
        self, shot: NDArray[np.int64], block: Measurement, state: ContentState
    ) -> tuple[Measurement, ContentState, list[FaultOccurrence]]:
        """Apply the faults to consecutive shots.

        Args:
            shot: (shots,) shot numbers of the scenario; those in `block` are the device's.
            block: shots with the device's numbers and times.
            state: state after the shots before.

        Returns:
            The shots as packets state them, the state after them, and the occurrences of faults.
        """
        occurrences, after = list[FaultOccurrence](), list[Row | None]()
        for (index, fault, schedule), before in zip(self._faults, state, strict=True):
            active, held = schedule.active_shots(shot), None
            match fault:
                case kinds.FrozenCounter():
                    counter, held = _frozen(block.shot, active, before)
                    block = replace(block, shot=counter)
                case kinds.TimeJump():
                    shifted_ns = np.clip(block.time_ns + round(fault.jump_s * 1e9), 0, LAST_NS)
                    block = replace(block, time_ns=np.where(active[:, None], shifted_ns, block.time_ns))
                case kinds.WrongUnit():
                    block = _in_other_units(block, active, fault.metres)
            after.append(held)
            occurrences += [FaultOccurrence(int(k), index, fault.kind, ()) for k in shot[active]]
        return block, tuple(after), occurrences


def _in_other_units(block: Measurement, active: NDArray[np.bool_], metres: float) -> Measurement:
    if not active.any():
        return block
    factor = np.where(active, 1 / metres, 1.0)[:, None]
    columns: dict[str, Any] = {name: factor * getattr(block, name) for name in _IN_METRES}
    return replace(block, **columns)


def _frozen(
    counter: NDArray[np.int64], active: NDArray[np.bool_], before: Row | None
) -> tuple[NDArray[np.int64], Row]:
    values, held = hold(counter[:, None], ~active[:, None], before)
    return values[:, 0], held


REWRITING = (kinds.OtherUnit, kinds.WrongEndian, kinds.OtherVersion)
"""Kinds of faults that `Rewriter` applies."""

_VERSION = "interface_version"


class Rewriter:
    """Rewrites packets and frames of an interface; other bytes are left unchanged."""

    def __init__(self, interface: Interface) -> None:
        self._interface = interface

    def refusal(self, fault: Any, can: bool) -> str | None:
        """What the interface needs for a fault to apply; None if it applies."""
        if isinstance(fault, kinds.OtherUnit) and fault.unit >= self._interface.units:
            return f"units 0 to {self._interface.units - 1} of the interface"
        if isinstance(fault, kinds.OtherVersion) and not self._states_version(can):
            return f"an interface that sends {_VERSION} as a field of whole bytes"
        return None

    def packet(self, frame: bytes, fault: Any) -> bytes:
        """Apply a fault to a framed packet."""
        link, definition = self._interface.link, self._interface.packet
        framing = link.framing
        try:
            (kind, unit, sequence), body = unseal(link, framing.packet_of(frame))
        except DecodeError:
            return frame
        if kind != "measurement":
            return frame
        first = definition.header.length
        blocks = [_changed(body[:first], definition.header, fault)]
        if definition.beam is not None:
            step = definition.beam.length
            blocks += [
                _changed(body[start : start + step], definition.beam, fault)
                for start in range(first, len(body), step)
            ]
        return framing.encode(seal(link, kind, _unit(unit, fault), sequence or 0, b"".join(blocks)))

    def frame(self, frame: CanFrame, fault: Any) -> CanFrame:
        """Apply a fault to a CAN frame."""
        address = self._addresses.get(frame.can_id)
        if address is None or (len(frame.data), frame.is_fd) != (
            address.message.layout.length,
            address.message.is_fd,
        ):
            return frame
        assert self._interface.can is not None
        offset = (_unit(address.unit, fault) - address.unit) * self._interface.can.unit_stride
        data = _changed(frame.data, address.message.layout, fault)
        return frame._replace(can_id=frame.can_id + offset, data=data)

    @cached_property
    def _addresses(self) -> dict[int, Address]:
        return addresses(self._interface)

    def _states_version(self, can: bool) -> bool:
        layouts = [self._interface.packet.header]
        if can:
            assert self._interface.can is not None
            layouts = [message.layout for message in self._interface.can.messages]
        return any(_places(layout, _VERSION) for layout in layouts)


def _unit(unit: int, fault: Any) -> int:
    return int(fault.unit) if isinstance(fault, kinds.OtherUnit) else unit


def _changed(data: bytes, layout: Layout, fault: Any) -> bytes:
    changed = bytearray(data)
    if isinstance(fault, kinds.WrongEndian):
        for place in _places(layout):
            changed[place] = data[place][::-1]
    elif isinstance(fault, kinds.OtherVersion):
        for place in _places(layout, _VERSION):
            changed[place] = fault.version.to_bytes(place.stop - place.start, layout.byte_order)
    return bytes(changed)


def _places(layout: Layout, name: str | None = None) -> list[slice]:
    return [
        slice(placed.first_byte, placed.end_byte)
        for placed in layout.placed
        if name in (None, placed.field.name)
        and placed.first_bit % 8 == 0
        and placed.field.codec.bits % 8 == 0
    ]

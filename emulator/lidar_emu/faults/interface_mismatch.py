"""Mismatch of the interface: another unit, byte order or version in packets and frames whose CRC is correct."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from lidar_emu.scenario.faults import packets as kinds
from lidar_protocol import CanFrame, DecodeError, Interface
from lidar_protocol.can_frames import Address, addresses
from lidar_protocol.layout import Layout
from lidar_protocol.packet import seal, unseal

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
    """Positions of the fields of whole bytes that have a name, or of all."""
    return [
        slice(placed.first_byte, placed.end_byte)
        for placed in layout.placed
        if name in (None, placed.field.name)
        and placed.first_bit % 8 == 0
        and placed.field.codec.bits % 8 == 0
    ]

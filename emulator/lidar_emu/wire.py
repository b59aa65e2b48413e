"""Encode measurements to packets, and decode received messages to rows of a table.

The only module that uses both `Measurement` and `lidar_protocol`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.device.state import TRACKING, Mode, Status
from lidar_emu.encoding.encode import ShotEncoder
from lidar_emu.encoding.tables import COLUMNS_ON_THE_WIRE, OF_A_SHOT, byte_tables, can_pieces, can_tables
from lidar_emu.errors import Finding, InputError, did_you_mean, nearest
from lidar_emu.files import check_file
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.lazy_kernel import has_machine_code
from lidar_emu.receiver.returns import Reason
from lidar_emu.scenario.schema import Wire
from lidar_protocol import (
    SHIPPED,
    CanFrame,
    CanSet,
    DefinitionError,
    Device,
    EncodeError,
    Interface,
    Message,
    load_file,
    shipped_interface,
)
from lidar_protocol.errors import UnknownKeyError
from lidar_protocol.fields import Constant, Value
from lidar_protocol.layout import FILLED_IN, Layout

Packet = bytes | list[CanFrame]
"""Packet of one shot: framed bytes, or CAN frames in the order of transmission."""

_columns = attrgetter(*COLUMNS_ON_THE_WIRE)
_CODES = [COLUMNS_ON_THE_WIRE.index(name) for name in ("reason", "second_reason")]
_BEAM_FIELDS = (*COLUMNS_ON_THE_WIRE, "time_offset_s")
_OF_A_BEAM = frozenset(_BEAM_FIELDS)
_OF_A_SHOT = frozenset(OF_A_SHOT)
_REASONS = tuple(reason.name.lower() for reason in Reason)


def interface_named(name: str, where: str, key: str | None = None) -> Interface:
    """Load a shipped interface by name, or an interface definition from a file.

    Args:
        name: name of a shipped interface, or a file name that ends in .toml.
        where: source of the name, for the error message.
        key: key of the name in the source.

    Raises:
        InputError: there is no such interface, or its definition cannot be used.
    """
    if name in SHIPPED:
        return shipped_interface(name)
    if not name.endswith(".toml"):
        choices = f"must be {', '.join(SHIPPED)}, or the name of a file, FILE.toml"
        raise InputError(where, key, name, did_you_mean(nearest(name, SHIPPED)) + choices)
    check_file(Path(name), "use a TOML file")
    try:
        return load_file(name)
    except UnknownKeyError as error:
        raise InputError(error.where, None, Finding("no such key"), error.expected) from None
    except DefinitionError as error:
        if error.value is None:
            raise InputError(error.where, None, Finding("missing"), f"add {error.expected}") from None
        raise InputError(error.where, None, error.value, f"must be {error.expected}") from None


class Encoder:
    """Encoder of the packets of one unit for one kind of link.

    Args:
        wire: interface, unit, and on classic CAN the set of messages.
        can: whether the link is a CAN bus.
        fd: whether the bus carries CAN FD frames.
        beam_count: beams of a shot.

    Raises:
        InputError: the interface cannot be used, holds fewer beams or units than the scenario has, or has fields that
            a measurement cannot fill.
    """

    def __init__(self, wire: Wire, can: bool, fd: bool, beam_count: int) -> None:
        self.interface = interface = interface_named(wire.interface, "scenario", "wire.interface")
        """Interface of the packets."""
        self._device = Device(interface, wire.unit)
        self._can_set: CanSet | None = ("fd" if fd else wire.can_messages) if can else None
        if wire.unit >= interface.units:
            raise InputError("scenario", "wire.unit", wire.unit, f"must be 0 to {interface.units - 1}")
        _check_beams(interface, wire.interface, can, beam_count)
        layouts = _layouts(interface, wire.interface, self._can_set)
        _check_fields(layouts, wire.interface)
        fields = (placed.field for _, layout, _ in layouts for placed in layout.placed)
        named = {field.name: field.enumeration for field in fields if field.enumeration}
        (track,) = _codes(interface, wire.interface, named.get("mode"), (Mode.TRACK,))
        # An interface need not have a code for acquisition.
        acquire = interface.enumerations.get(named.get("mode", ""), {}).get(Mode.ACQUIRE, track)
        self._modes = {Mode.TRACK: track, Mode.ACQUIRE: acquire}
        self._reasons = _codes(interface, wire.interface, named.get("reason"), _REASONS)
        self._pieces: list[tuple[int, slice, bool]] = []
        if self._can_set is None:
            tables = byte_tables(interface, wire.unit, beam_count)
        else:
            tables = can_tables(interface, self._can_set, beam_count)
            self._pieces = can_pieces(interface, wire.unit, self._can_set, beam_count)
        self._kernel = None if tables is None else ShotEncoder(tables, self._reasons, beam_count)

    def packets(self, measurement: Measurement, status: Status = TRACKING) -> Iterator[Packet]:
        """Encode each shot with the status of the device; packets are empty if the device is silent."""
        if status.silent:
            for _ in range(len(measurement)):
                yield b"" if self._can_set is None else []
            return
        done = 0
        # A bench pattern needs no compiler.
        if self._kernel is not None and has_machine_code():
            own = self._modes[status.mode], status.laser_on, status.clock_locked
            for data in self._kernel.encoded(measurement, own):
                yield data if self._can_set is None else self._can_frames(data)
                done += 1
        if done < len(measurement):
            yield from self._one_by_one(measurement.part(done, len(measurement)), status)

    def _can_frames(self, data: bytes) -> list[CanFrame]:
        return [CanFrame(can_id, data[piece], is_fd, is_fd) for can_id, piece, is_fd in self._pieces]

    def _one_by_one(self, measurement: Measurement, status: Status) -> Iterator[Packet]:
        """Encode what the kernel does not: values that cannot be sent, and unusual fields."""
        for header, beams in self._shots(measurement, status):
            try:
                if self._can_set is None:
                    yield self._device.serial_bytes(header, beams)
                else:
                    yield self._device.can_frames(self._can_set, header, beams)
            except EncodeError as error:
                raise InputError(
                    "wire", f"shot {header['shot']}", Finding(str(error)), "use wider fields"
                ) from None

    def can_encode_time(self, measurement: Measurement, shown_ns: int) -> bool:
        """Whether a packet with the contents of these shots can encode this time."""
        if not 0 <= shown_ns < 1 << 62:
            return False
        one = measurement.one(0)
        times_ns, due_ns = np.full_like(one.time_ns, shown_ns), np.full_like(one.due_ns, shown_ns)
        try:
            next(self.packets(replace(one, time_ns=times_ns, due_ns=due_ns)))
        except InputError:
            return False
        return True

    def _shots(
        self, measurement: Measurement, status: Status
    ) -> Iterator[tuple[Mapping[str, Value], Sequence[Mapping[str, Value]]]]:
        mode = self._modes[status.mode]
        # Lists of Python numbers: the protocol has no arrays, and float(array element) is slower.
        columns = [column.tolist() for column in _columns(measurement)]
        for index in _CODES:
            columns[index] = [[self._reasons[code] for code in row] for row in columns[index]]
        times_ns = measurement.time_ns.tolist()
        first_ns = [min(row) for row in times_ns]
        columns.append(
            [
                [(time_ns - first) * 1e-9 for time_ns in row]
                for row, first in zip(times_ns, first_ns, strict=True)
            ]
        )
        columns_of_shot = measurement.shot, measurement.pattern, measurement.due_ns
        shots = zip(first_ns, *(column.tolist() for column in columns_of_shot), strict=True)
        for row, (time_ns, shot, pattern, due_ns) in enumerate(shots):
            header = {
                "time_ns": time_ns,
                "time_s": time_ns * 1e-9,
                "due_ns": due_ns,
                "due_s": due_ns * 1e-9,
                "mode": mode,
                "laser_on": status.laser_on,
                "clock_locked": status.clock_locked,
                "shot": shot,
                "pattern": pattern,
            }
            of_beams = zip(*[column[row] for column in columns], strict=True)
            beams = [dict(zip(_BEAM_FIELDS, values, strict=True)) for values in of_beams]
            yield header, beams


_Block = tuple[str, Layout, frozenset[str]]
"""Block of a packet: its place in the definition, its layout, and the names of values that can fill its fields."""


def _check_beams(interface: Interface, where: str, can: bool, beam_count: int) -> None:
    if can and interface.can is None:
        raise InputError(where, "can", Finding("missing"), "use a byte link, or define [can]")
    if interface.can is not None and can:
        least, most, place = 1, interface.can.beam_slots, "a CAN bus"
    else:
        packet = interface.packet
        least, most, place = max(1, packet.beams_in_header), packet.maximum_beams, "a packet"
    if beam_count > most:
        raise InputError("scenario", "beams", beam_count, f"must be at most {most} on {place}")
    if beam_count < least:
        raise InputError("scenario", "beams", beam_count, f"must be at least {least} with interface {where}")


def _layouts(interface: Interface, where: str, can_set: CanSet | None) -> list[_Block]:
    if can_set is None:
        packet = interface.packet
        header = ("packet.header", packet.header, _OF_A_SHOT)
        return [header] if packet.beam is None else [header, ("packet.beam", packet.beam, _OF_A_BEAM)]
    assert interface.can is not None
    if can_set not in interface.can.sets:
        remedy = f"use {' or '.join(interface.can.sets)}"
        raise InputError(where, "can.messages", Finding(f"no set {can_set}"), remedy)
    return [
        (f"can.messages {each.name}", each.layout, _OF_A_BEAM if each.each_beam else _OF_A_SHOT)
        for each in interface.can.sets[can_set]
    ]


def _check_fields(blocks: list[_Block], where: str) -> None:
    for place, layout, known in blocks:
        for field in (placed.field for placed in layout.placed):
            fillable = known if field.beam is None else _OF_A_BEAM
            if field.name not in fillable | FILLED_IN and not isinstance(field.codec, Constant):
                remedy = f"must be a constant, or one of {', '.join(sorted(fillable))}"
                raise InputError(where, place, field.name, remedy)


def _codes(interface: Interface, where: str, enumeration: str | None, words: Sequence[str]) -> list[int]:
    """Codes of these names in an enumeration; without one, their indices in the list."""
    if enumeration is None:
        return list(range(len(words)))
    codes = interface.enumerations[enumeration]
    if missing := [word for word in words if word not in codes]:
        found, needed = Finding(f"no {', '.join(missing)}"), f"define {', '.join(words)}"
        raise InputError(where, f"enumerations.{enumeration}", found, needed)
    return [codes[word] for word in words]


def rows(message: Message) -> list[dict[str, Any]]:
    """Rows of a decoded message, one per beam, with the names of `Measurement.table`; None where a value is missing.

    `packet_time_s` is the time of validity of the first beam. The core set on CAN has only some of the columns: without
    a time offset the time of a beam is unknown.
    """
    packet_time_s = None if message.time_ns is None else message.time_ns * 1e-9
    unit = {"unit": message.unit, "shot": message.shot, "packet_time_s": packet_time_s}
    pattern = {"pattern": message.header["pattern"]} if "pattern" in message.header else {}
    result = []
    for beam, values in enumerate(message.beams):
        row: dict[str, Any] = {**unit, "beam": beam, "time_s": _time_s(message, values), **pattern}
        row.update((name, values[name]) for name in COLUMNS_ON_THE_WIRE if name in values)
        result.append(row)
    return result


def _time_s(message: Message, beam: Mapping[str, Value]) -> float | None:
    offset_s = beam.get("time_offset_s")
    if message.time_ns is None or offset_s is None or not beam.get("fired"):
        return None
    return message.time_ns * 1e-9 + offset_s

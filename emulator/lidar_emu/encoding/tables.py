"""An interface as tables of numbers, from which a kernel encodes shots; `lidar_protocol` defines what it must give.

A frame on a byte link, or the data of all CAN frames of a shot, is a sequence of blocks, and a block is a list of
fields. Each field takes a value of `SOURCES` and has a codec, whose numbers are in its row.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.measurement import COLUMNS
from lidar_emu.numerics.arrays import Group, as_record, in_groups
from lidar_emu.numerics.kernels import with_fields
from lidar_protocol import CanSet, Interface
from lidar_protocol.crc import table_of
from lidar_protocol.definitions import ByteLink, CanDefinition, CanMessage
from lidar_protocol.fields import Codec, Constant, Counter, Field, Flag, Number, Real, Time
from lidar_protocol.headers import PlainHeader
from lidar_protocol.layout import Layout, PlacedField

COLUMNS_ON_THE_WIRE: Final = tuple(in_groups(COLUMNS, Group.POINTING, Group.REPORT))
"""Columns of a measurement that packets can hold."""

OF_A_SHOT: Final = (
    "time_ns", "due_ns", "shot", "pattern", "mode", "laser_on", "clock_locked", "time_s", "due_s",
)  # fmt: skip
OWN: Final = ("shot_counter", "interface_version", "beam_count", "details")
SOURCES: Final = (*OF_A_SHOT, *OWN, *COLUMNS_ON_THE_WIRE, "time_offset_s")
"""Names of values that a field can hold, in the order of their rows in the kernel."""

_REAL: Final = {"time_s", "due_s", "time_offset_s"} | {
    name for name in COLUMNS_ON_THE_WIRE if COLUMNS[name].is_float
}

FLAG, CONSTANT, COUNTER, TIME, WHOLE, SCALED, SINGLE, DOUBLE = range(8)

FIELD = np.dtype(
    [(name, "i8") for name in ("kind", "source", "beam", "bits", "byte", "shift", "step", "code")]
    + [(name, "i8") for name in ("low", "high", "offset", "lowest_raw", "highest_raw", "none")]
    + [(name, "f8") for name in ("lowest", "end", "steps_per_unit")]
    + [(name, "?") for name in ("is_real", "nearest", "has_none")],
    align=True,
)
"""A field. `beam`: whose value it holds, -1 for the block's; `byte` and `shift`: byte of the block and bit in it with
the least significant bit, from which `step` leads to the byte with the next bits; `code`: of a constant; `low`, `high`:
whole values in range; `lowest`, `end`: values in steps from the lowest to below the end are in range; for `SINGLE` and
`DOUBLE` the lowest and the highest value."""

BLOCK = np.dtype(
    [(name, "i8") for name in ("first", "end", "byte", "length", "beam", "unless", "absent")], align=True
)
"""A block: its fields, place, length, beam (0 for the shot), the flag without which it is absent (-1: none), and the
place of its absent form for each shot counter."""

COBS, SLIP, PLAIN = range(3)


class LinkConstants(NamedTuple):
    """Constants of a byte link; of CAN only `counter_mask` counts."""

    framing: int
    covered: int
    """First byte under the CRC."""
    crc_byte: int
    """Byte at which the CRC starts."""
    crc_length: int
    crc_start: int
    crc_reflected: bool
    crc_xor: int
    crc_big: bool
    counter_mask: int
    """Bits of the shot counter on CAN."""


class Tables(NamedTuple):
    """What the kernel encodes by."""

    fields: NDArray[Any]
    blocks: NDArray[Any]
    link: NDArray[Any]
    template: NDArray[np.uint8]
    """A shot before its blocks are set."""
    absent: NDArray[np.uint8]
    """Blocks of absent beams."""
    crc: NDArray[np.int64]
    """Register after each byte."""
    own: NDArray[np.int64]
    """Interface version, number of beams and details."""


def byte_tables(interface: Interface, unit: int, beam_count: int) -> Tables | None:
    """Tables of the packets on a byte link; None if a field is beyond the kernel."""
    link, packet = interface.link, interface.packet
    body = packet.header.length + (beam_count * packet.beam.length if packet.beam else 0)
    length = link.overhead + body
    head = link.framing.head(length)
    rows = _Rows(frozenset(SOURCES) - {"shot_counter", "details"})
    rows.add_header(link, unit, length, len(head))
    at = len(head) + link.header.length
    rows.add(packet.header, at)
    for beam in range(beam_count if packet.beam else 0):
        assert packet.beam is not None
        rows.add(packet.beam, at + packet.header.length + beam * packet.beam.length, beam)
    if not rows.possible:
        return None
    covered = {"packet": len(head), "body": at, "frame": 0}[link.covered]
    kind = {"cobs": COBS, "slip": SLIP}.get(link.framing.kind, PLAIN)
    template = np.zeros(len(head) + length, dtype=np.uint8)
    template[: len(head)] = list(head)
    return rows.tables(
        _link(link, kind, covered, len(template) - link.crc_length),
        template,
        (interface.version, beam_count, 0),
        np.zeros(256, np.int64) if link.crc is None else np.array(table_of(link.crc), np.int64),
    )


def can_tables(interface: Interface, can_set: CanSet, beam_count: int) -> Tables | None:
    """Tables of the data of all CAN frames of a shot, one after another; None if a field is beyond the kernel."""
    assert interface.can is not None
    rows, at = _Rows(frozenset(SOURCES)), 0
    for message, beam, piece in _can_messages(interface.can, can_set, beam_count):
        flag = message.absent_unless if message.each_beam else None
        rows.add(message.layout, piece.start, beam, flag, message.absent_blocks)
        at = piece.stop
    if not rows.possible:
        return None
    none = LinkConstants(PLAIN, 0, at, 0, 0, False, 0, False, interface.can.counter_mask)
    own = interface.version, beam_count, int(can_set == "full")
    return rows.tables(none, np.zeros(at, dtype=np.uint8), own, np.zeros(256, np.int64))


def can_pieces(
    interface: Interface, unit: int, can_set: CanSet, beam_count: int
) -> list[tuple[int, slice, bool]]:
    """Identifiers of the frames of a shot, the bytes of the data that each takes, and whether it is CAN FD."""
    can = interface.can
    assert can is not None
    return [
        (can.can_id(unit, message, slot), piece, can_set == "fd")
        for message, slot, piece in _can_messages(can, can_set, beam_count)
    ]


def _can_messages(
    can: CanDefinition, can_set: CanSet, beam_count: int
) -> Iterator[tuple[CanMessage, int, slice]]:
    """Messages of a shot in the order of transmission, with their slots and their bytes of the data."""
    at = 0
    for message in can.sets[can_set]:
        for slot in range(beam_count if message.each_beam else 1):
            yield message, slot, slice(at, at + message.layout.length)
            at += message.layout.length


def _link(link: ByteLink, framing: int, covered: int, crc_byte: int) -> LinkConstants:
    if link.crc is None:
        return LinkConstants(framing, covered, crc_byte, 0, 0, False, 0, False, 0)
    crc, big = link.crc, link.byte_order == "big"
    return LinkConstants(
        framing, covered, crc_byte, crc.length, crc.start, crc.reflected, crc.final_xor, big, 0
    )


class _Rows:
    def __init__(self, sources: frozenset[str]) -> None:
        self._sources = sources
        self._fields: list[dict[str, Any]] = []
        self._blocks: list[tuple[int, ...]] = []
        self._absent = bytearray()
        self.possible = True
        """Whether the kernel can encode all fields."""

    def add(
        self,
        layout: Layout,
        at: int,
        beam: int = 0,
        unless: str | None = None,
        absent: Iterable[bytes] = (),
        constants: Mapping[str, int] | None = None,
    ) -> None:
        """Add a block at a byte.

        Args:
            constants: values that are the same in all shots.
        """
        first, place = len(self._fields), len(self._absent)
        for placed in layout.placed:
            row = _row(placed, layout, self._sources, constants or {})
            self.possible &= row is not None
            self._fields.append(row or {})
        if unless is not None:
            self._absent += b"".join(absent)
        flag = -1 if unless is None else SOURCES.index(unless)
        self._blocks.append((first, len(self._fields), at, layout.length, beam, flag, place))

    def add_header(self, link: ByteLink, unit: int, length: int, at: int) -> None:
        """Add the header of a packet."""
        header = link.header
        if isinstance(header, PlainHeader):
            known = {"unit": unit, "length": length, "message": header.messages["measurement"]}
            self.add(header.layout, at, constants=known)
            return
        words = header.pack("measurement", unit, 0, length)
        fields = [
            PlacedField(Field("identification", Constant(16, int.from_bytes(words[:2], "big"))), 0),
            PlacedField(Field("segments", Constant(2, words[2] >> 6)), 16),
            PlacedField(Field("sequence", Counter(14)), 18),
            PlacedField(Field("length", Constant(16, int.from_bytes(words[4:], "big"))), 32),
        ]
        self.add(Layout(6, tuple(fields), "big"), at)

    def tables(
        self,
        link: LinkConstants,
        template: NDArray[np.uint8],
        own: tuple[int, int, int],
        crc: NDArray[np.int64],
    ) -> Tables:
        fields = np.zeros(len(self._fields), dtype=FIELD)
        for row, values in zip(fields, self._fields, strict=True):
            for name, value in values.items():
                row[name] = value
        return Tables(
            with_fields(fields),
            with_fields(np.array(self._blocks, dtype=BLOCK)),
            as_record(link),
            template,
            np.array(list(self._absent or b"\0"), dtype=np.uint8),
            crc,
            np.array(own, dtype=np.int64),
        )


def _row(
    placed: PlacedField, layout: Layout, sources: frozenset[str], constants: Mapping[str, int]
) -> dict[str, Any] | None:
    """Columns of `FIELD`; None if the kernel cannot encode the field."""
    field, codec = placed.field, placed.field.codec
    last = placed.first_bit + codec.bits
    if layout.byte_order == "big":
        place = {"byte": (last - 1) // 8, "shift": -last % 8, "step": -1}
    else:
        place = {"byte": placed.first_bit // 8, "shift": placed.first_bit % 8, "step": 1}
    place["bits"] = codec.bits
    if isinstance(codec, Constant):
        return place | {"kind": CONSTANT, "code": _wrapped(codec.code)}
    if field.name in constants:
        block = Layout((codec.bits + 7) // 8, (placed._replace(first_bit=0),), "little")
        return place | {"kind": CONSTANT, "code": _wrapped(int.from_bytes(block.pack(constants), "little"))}
    name = "shot" if field.name == "sequence" else field.name
    if name not in sources:
        return None
    values = _codec(codec, name in _REAL)
    if values is None:
        return None
    at = -1 if field.beam is None else field.beam
    return place | values | {"source": SOURCES.index(name), "is_real": name in _REAL, "beam": at}


def _codec(codec: Codec, is_real: bool) -> dict[str, Any] | None:
    match codec:
        case Flag():
            return {"kind": FLAG}
        case Counter() if not is_real:
            return {"kind": COUNTER}
        case Time() if not is_real:
            return {"kind": TIME}
        case Real():
            limits = {"lowest": codec.lowest, "end": codec.highest, "nearest": codec.nearest}
            return {"kind": SINGLE if codec.bits == 32 else DOUBLE} | limits
        case Number():
            return _number(codec)
    return None


def _number(codec: Number) -> dict[str, Any] | None:
    lowest, end = codec.lowest, codec.highest + 1
    if float(lowest) != lowest or float(end) != end:
        return None
    low, high = (min(max(limit + codec.offset, -(1 << 63)), (1 << 63) - 1) for limit in (lowest, end - 1))
    return {
        "kind": WHOLE if codec.whole else SCALED,
        "low": low,
        "high": high,
        "offset": codec.offset,
        "lowest": lowest,
        "end": end,
        "lowest_raw": _wrapped(lowest),
        "highest_raw": _wrapped(end - 1),
        "steps_per_unit": codec.steps_per_unit,
        "nearest": codec.nearest,
        "has_none": codec.none is not None,
        "none": _wrapped(codec.none or 0),
    }


def _wrapped(bits: int) -> int:
    """The number of 64 bits with a sign that has these bits."""
    return (bits + (1 << 63)) % (1 << 64) - (1 << 63)

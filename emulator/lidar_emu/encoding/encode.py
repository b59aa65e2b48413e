"""The kernel that encodes shots by the tables of an interface."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, nan
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.encoding.tables import (
    COBS,
    COLUMNS_ON_THE_WIRE,
    CONSTANT,
    COUNTER,
    DOUBLE,
    FLAG,
    OF_A_SHOT,
    OWN,
    SINGLE,
    SLIP,
    SOURCES,
    TIME,
    WHOLE,
    Tables,
)
from lidar_emu.measurement import COLUMNS, Measurement
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel

_Bytes = NDArray[np.uint8]
_columns = attrgetter(*COLUMNS_ON_THE_WIRE)

_LARGEST = 2.0**63
_EXACT = 1 << 53
"""Whole numbers up to here are exact as floating-point numbers."""
_NS_PER_S = 1_000_000_000
_HALF_S = _NS_PER_S // 2
_SECONDS = 1 << 32
_CODED = "reason", "second_reason"
_OFFSET = SOURCES.index("time_offset_s")
_TIME, _DUE, _SHOT, _PATTERN, _MODE, _LASER, _CLOCK, _TIME_S, _DUE_S = range(len(OF_A_SHOT))
_FIRST_OF_A_BEAM = len(OF_A_SHOT) + len(OWN)
_COUNTER, _VERSION, _BEAMS, _DETAILS = range(len(OF_A_SHOT), _FIRST_OF_A_BEAM)
_END, _ESCAPE, _ESCAPED_END, _ESCAPED_ESCAPE = 0xC0, 0xDB, 0xDC, 0xDD


def _gathering() -> Any:
    """A kernel (columns, s, codes, whole, real) that sets the rows of a shot's columns. Columns have several types, so
    that no loop can run over them."""
    lines = ["def gather(columns, s, codes, whole, real):"]
    for k, name in enumerate(COLUMNS_ON_THE_WIRE):
        row, value = SOURCES.index(name), f"columns[{k}][s, b]"
        lines.append(f" for b in range(columns[{k}].shape[1]):")
        if COLUMNS[name].is_float:
            lines.append(f"  real[{row}, b] = {value}")
            continue
        value = f"codes[{value}]" if name in _CODED else f"np.int64({value})"
        lines += [f"  whole[{row}, b] = {value}", f"  real[{row}, b] = whole[{row}, b]"]
    scope: dict[str, Any] = {"np": np, "__name__": __name__}
    exec("\n".join(lines), scope)
    return kernel(scope["gather"])


_gather = _gathering()


class ShotEncoder:
    """Encodes shots by tables.

    Args:
        tables: of the interface.
        codes: what stands for each reason on the wire.
        beam_count: beams of a shot.
    """

    def __init__(self, tables: Tables, codes: Sequence[int], beam_count: int) -> None:
        self._tables, self._codes = tuple(tables), np.array(codes, dtype=np.int64)
        shape = len(SOURCES), beam_count
        self._values = np.zeros(shape, dtype=np.int64), np.zeros(shape)
        self._frame = np.empty_like(tables.template)
        self._encode: Any = encode_shots

    def encoded(self, measurement: Measurement, status: tuple[int, bool, bool]) -> list[bytes]:
        """Encode shots, until one has a value that cannot be sent or that the tables do not cover.

        Args:
            measurement: shots.
            status: code of the mode, and whether the laser is on and the clock is locked.
        """
        shots = len(measurement)
        frames = np.empty((shots, 2 * len(self._frame) + 2), dtype=np.uint8)
        lengths = np.empty(shots, dtype=np.int64)
        times = measurement.time_ns, measurement.due_ns, measurement.shot, measurement.pattern
        done = self._encode(
            self._tables,
            tuple([_plain(column) for column in times]),
            np.array(status, dtype=np.int64),
            self._codes,
            tuple([_plain(column) for column in _columns(measurement)]),
            self._values,
            self._frame,
            frames,
            lengths,
        )
        return [frames[s, : lengths[s]].tobytes() for s in range(done)]


def _plain(column: NDArray[Any]) -> NDArray[Any]:
    """A column in the layout for which kernels are built."""
    return column if column.flags.carray else column.copy()


@kernel(outermost=True)
def encode_shots(
    tables: tuple[Any, ...],
    times: tuple[Any, ...],
    status: IntArray,
    codes: IntArray,
    columns: tuple[Any, ...],
    values: tuple[IntArray, FloatArray],
    frame: _Bytes,
    frames: _Bytes,
    lengths: IntArray,
) -> int:
    """Encode shots, until one has a value that cannot be sent or that the tables do not cover.

    Args:
        tables: the arrays of `Tables`.
        times: times of validity (shots, beams); due times, numbers and patterns of the shots (shots,).
        status: mode, and whether the laser is on and the clock is locked.
        codes: what stands for each reason on the wire.
        columns: `COLUMNS_ON_THE_WIRE`, (shots, beams).
        values: whole and real numbers (sources, beams), overwritten.
        frame: a shot without stuffing, overwritten.
        frames: (shots, longest) frames, of these `lengths`.

    Returns:
        Number of shots that are encoded.
    """
    fields, blocks, links, template, absent, crc, own = tables
    whole, real = values
    link = links[0]
    for s in range(len(lengths)):
        _set_shot(times, s, status, own, link.counter_mask, whole, real)
        _gather(columns, s, codes, whole, real)
        for i in range(len(template)):
            frame[i] = template[i]
        for k in range(len(blocks)):
            block = blocks[k]
            if block.unless >= 0 and real[block.unless, block.beam] == 0.0:
                at = block.absent + whole[_COUNTER, 0] * block.length
                for i in range(block.length):
                    frame[block.byte + i] = absent[at + i]
                continue
            for f in range(block.first, block.end):
                field = fields[f]
                beam = block.beam if field.beam < 0 else field.beam
                beam = 0 if field.source < _FIRST_OF_A_BEAM else beam
                is_sendable, bits = _bits(field, whole[field.source, beam], real[field.source, beam])
                if not is_sendable:
                    return s
                _put(frame, block.byte + field.byte, field, bits)
        lengths[s] = _frame(link, crc, frame, frames[s])
    return len(lengths)


@kernel
def _set_shot(
    times: tuple[Any, ...],
    s: int,
    status: IntArray,
    own: IntArray,
    counter_mask: int,
    whole: IntArray,
    real: FloatArray,
) -> None:
    time_ns, due_ns, shot, pattern = times
    first_ns = time_ns[s, 0]
    for b in range(time_ns.shape[1]):
        first_ns = min(first_ns, time_ns[s, b])
    for b in range(time_ns.shape[1]):
        real[_OFFSET, b] = (time_ns[s, b] - first_ns) * 1e-9
    whole[_TIME, 0], whole[_DUE, 0], whole[_SHOT, 0], whole[_PATTERN, 0] = (
        first_ns,
        due_ns[s],
        shot[s],
        pattern[s],
    )
    whole[_MODE, 0], whole[_LASER, 0], whole[_CLOCK, 0] = status[0], status[1], status[2]
    whole[_COUNTER, 0] = shot[s] & counter_mask
    whole[_VERSION, 0], whole[_BEAMS, 0], whole[_DETAILS, 0] = own[0], own[1], own[2]
    for row in range(_FIRST_OF_A_BEAM):
        real[row, 0] = whole[row, 0]
    real[_TIME_S, 0], real[_DUE_S, 0] = first_ns * 1e-9, due_ns[s] * 1e-9


@kernel
def _bits(field: Any, whole: int, real: float) -> tuple[bool, int]:
    """Whether a value can be sent, and its bits; see `lidar_protocol.fields`."""
    kind = field.kind
    if kind == CONSTANT:
        return True, field.code
    if kind == FLAG:
        return True, int(real != 0.0)
    if kind == COUNTER:
        return True, whole
    if kind == TIME:
        seconds = whole // _NS_PER_S
        ticks = (seconds << 24) + (((whole - seconds * _NS_PER_S) << 24) + _HALF_S) // _NS_PER_S
        return 0 <= ticks < _SECONDS << 24, ticks
    if kind in (SINGLE, DOUBLE):
        return True, _bits_of_real(field, real)
    if kind == WHOLE:
        if not field.is_real and field.low <= whole <= field.high:
            return True, whole - field.offset
        steps = real + (0.5 - field.offset)
    else:
        steps = real * field.steps_per_unit + 0.5
    if not field.is_real and abs(whole) > _EXACT:
        return False, 0
    if field.lowest <= steps < field.end:
        return abs(steps) < _LARGEST, floor(steps) if abs(steps) < _LARGEST else 0
    if field.nearest and real == real:
        below = (real - field.offset) * field.steps_per_unit < field.lowest
        return True, field.lowest_raw if below else field.highest_raw
    return field.has_none, field.none


@kernel
def _bits_of_real(field: Any, real: float) -> int:
    if not field.lowest <= real <= field.end:
        limit = field.lowest if real < field.lowest else field.end
        real = limit if field.nearest and real == real else nan
    if field.kind == SINGLE:
        return int(np.float32(real).view(np.int32))
    return int(np.float64(real).view(np.int64))


@kernel
def _put(frame: _Bytes, byte: int, field: Any, bits: int) -> None:
    left, shift = field.bits, field.shift
    while left > 0:
        width = min(8 - shift, left)
        frame[byte] |= np.uint8((bits & ((1 << width) - 1)) << shift)
        bits >>= width
        left -= width
        byte += field.step
        shift = 0


@kernel
def _frame(link: Any, crc: IntArray, packet: _Bytes, frame: _Bytes) -> int:
    """Append the CRC to a packet, and frame it; returns the length."""
    length = link.crc_byte + link.crc_length
    if link.crc_length > 0:
        check = _checksum(link, crc, packet)
        for i in range(link.crc_length):
            at = link.crc_length - 1 - i if link.crc_big else i
            packet[link.crc_byte + at] = np.uint8(check >> (8 * i) & 0xFF)
    if link.framing == COBS:
        return _stuff(packet[:length], frame)
    if link.framing == SLIP:
        return _escape(packet[:length], frame)
    for i in range(length):
        frame[i] = packet[i]
    return int(length)


@kernel
def _checksum(link: Any, table: IntArray, packet: _Bytes) -> int:
    register = link.crc_start
    if link.crc_reflected:
        for i in range(link.covered, link.crc_byte):
            register = register >> 8 ^ table[(register ^ packet[i]) & 0xFF]
        return int(register ^ link.crc_xor)
    down = 8 * link.crc_length - 8
    mask = (1 << 8 * link.crc_length) - 1
    for i in range(link.covered, link.crc_byte):
        register = (register << 8) & mask ^ table[register >> down ^ packet[i]]
    return int(register ^ link.crc_xor)


@kernel
def _stuff(packet: _Bytes, frame: _Bytes) -> int:
    """Frame by `lidar_protocol.cobs`."""
    frame[0] = 0
    place, end, code = 1, 2, 1
    for byte in packet:
        if code == 255:
            frame[place] = code
            place, end, code = end, end + 1, 1
        if byte == 0:
            frame[place] = code
            place, end, code = end, end + 1, 1
        else:
            frame[end] = byte
            end, code = end + 1, code + 1
    frame[place], frame[end] = code, 0
    return end + 1


@kernel
def _escape(packet: _Bytes, frame: _Bytes) -> int:
    """Frame by SLIP."""
    frame[0] = _END
    end = 1
    for byte in packet:
        if byte in (_END, _ESCAPE):
            frame[end], frame[end + 1] = _ESCAPE, _ESCAPED_END if byte == _END else _ESCAPED_ESCAPE
            end += 2
        else:
            frame[end] = byte
            end += 1
    frame[end] = _END
    return end + 1

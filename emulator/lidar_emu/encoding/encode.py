"""The kernel that encodes shots by the tables of an interface."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, nan
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
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.lazy_kernel import Kernel
from lidar_emu.packed_measurement import GROUPS, Rows, packed, places

_Bytes = NDArray[np.uint8]

_LARGEST = 2.0**63
_EXACT = 1 << 53
"""Whole numbers up to here are exact as floating-point numbers."""
_NS_PER_S = 1_000_000_000
_HALF_S = _NS_PER_S // 2
_SECONDS = 1 << 32
_REALS, _INTEGERS, _BYTES, _SIGNED_BYTES, _FLAGS = (
    GROUPS.index(dtype) for dtype in ("f8", "i8", "u1", "i1", "?")
)
_OFFSET = SOURCES.index("time_offset_s")
_TIME, _DUE, _SHOT, _PATTERN, _MODE, _LASER, _CLOCK, _TIME_S, _DUE_S = range(len(OF_A_SHOT))
_FIRST_OF_A_BEAM = len(OF_A_SHOT) + len(OWN)
_COUNTER, _VERSION, _BEAMS, _DETAILS = range(len(OF_A_SHOT), _FIRST_OF_A_BEAM)
_END, _ESCAPE, _ESCAPED_END, _ESCAPED_ESCAPE = 0xC0, 0xDB, 0xDC, 0xDD


class ShotEncoder:
    """Encodes shots by tables.

    Args:
        tables: of the interface.
        codes: what stands for each reason on the wire.
        beam_count: beams of a shot.
    """

    def __init__(self, tables: Tables, codes: Sequence[int], beam_count: int) -> None:
        self._tables, self._codes = tuple(tables), np.array(codes, dtype=np.int64)
        self._sources = _sources(beam_count)
        shape = len(SOURCES), beam_count
        self._values = np.zeros(shape, dtype=np.int64), np.zeros(shape)
        self._frame = np.empty_like(tables.template)
        self._kernel: Any = encode_shots
        self._encode = self._kernel

    def encoded(self, measurement: Measurement, status: tuple[int, bool, bool]) -> list[bytes]:
        """Encode shots, until one has a value that cannot be sent or that the tables do not cover.

        Args:
            measurement: shots.
            status: code of the mode, and whether the laser is on and the clock is locked.
        """
        rows = packed(measurement)
        shots = len(rows[0])
        frames = np.empty((shots, 2 * len(self._frame) + 2), dtype=np.uint8)
        lengths = np.empty(shots, dtype=np.int64)
        args = (
            self._tables,
            self._sources,
            rows,
            status,
            self._codes,
            self._values,
            self._frame,
            frames,
            lengths,
        )
        done = self._encode(*args)
        if self._encode is self._kernel and isinstance(self._kernel, Kernel):
            self._encode = self._kernel.entry(args)
        return [frames[s, : lengths[s]].tobytes() for s in range(done)]


def _sources(beams: int) -> IntArray:
    """(sources, 4) For each column that a measurement gives: its row among the sources, its type, and its place."""
    of_a_shot = "time_ns", "due_ns", "shot", "pattern"
    found = []
    for name in (*of_a_shot, *COLUMNS_ON_THE_WIRE):
        place = places(beams)[name]
        found.append((SOURCES.index(name), place.group, place.first, place.end - place.first))
    return np.array(found, dtype=np.int64)


@kernel(outermost=True)
def encode_shots(
    tables: tuple[Any, ...],
    sources: IntArray,
    rows: Rows,
    status: tuple[int, bool, bool],
    codes: IntArray,
    values: tuple[IntArray, FloatArray],
    frame: _Bytes,
    frames: _Bytes,
    lengths: IntArray,
) -> int:
    """Encode shots, until one has a value that cannot be sent or that the tables do not cover.

    Args:
        tables: the arrays of `Tables`.
        sources: see `_sources`.
        rows: of the measurement.
        status: mode, and whether the laser is on and the clock is locked.
        codes: what stands for each reason on the wire.
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
        _set_columns(sources, rows, s, codes, whole, real)
        _set_shot(rows[_INTEGERS][s], sources[0], status, own, link.counter_mask, whole, real)
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
def _set_columns(
    sources: IntArray, rows: Rows, s: int, codes: IntArray, whole: IntArray, real: FloatArray
) -> None:
    for k in range(len(sources)):
        row, group, first, count = sources[k, 0], sources[k, 1], sources[k, 2], sources[k, 3]
        for b in range(min(count, real.shape[1])):
            at = first + b
            if group == _REALS:
                real[row, b] = rows[_REALS][s, at]
                continue
            if group == _INTEGERS:
                number = rows[_INTEGERS][s, at]
            elif group == _BYTES:
                number = np.int64(rows[_BYTES][s, at])
            elif group == _SIGNED_BYTES:  # codes
                number = codes[rows[_SIGNED_BYTES][s, at]]
            else:
                number = np.int64(rows[_FLAGS][s, at])
            whole[row, b] = number
            real[row, b] = number


@kernel
def _set_shot(
    integers: IntArray,
    times: IntArray,
    status: tuple[int, bool, bool],
    own: IntArray,
    counter_mask: int,
    whole: IntArray,
    real: FloatArray,
) -> None:
    """Set what follows from the columns: times from the first beam's, and the rows of the device."""
    time_ns = integers[times[2] : times[2] + times[3]]
    first_ns = time_ns[0]
    for b in range(len(time_ns)):
        first_ns = min(first_ns, time_ns[b])
    for b in range(len(time_ns)):
        real[_OFFSET, b] = (time_ns[b] - first_ns) * 1e-9
    whole[_TIME, 0] = first_ns
    whole[_MODE, 0], whole[_LASER, 0], whole[_CLOCK, 0] = status[0], status[1], status[2]
    whole[_COUNTER, 0] = whole[_SHOT, 0] & counter_mask
    whole[_VERSION, 0], whole[_BEAMS, 0], whole[_DETAILS, 0] = own[0], own[1], own[2]
    for row in range(_FIRST_OF_A_BEAM):
        real[row, 0] = whole[row, 0]
    real[_TIME_S, 0], real[_DUE_S, 0] = first_ns * 1e-9, whole[_DUE, 0] * 1e-9


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

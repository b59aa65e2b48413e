"""Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999).

Stuffed bytes contain no zero, so that a zero can end each frame. Every run of up to 254 bytes without a zero
is preceded by a code byte: the distance to the next zero that was taken out, or 255 where none was.
"""

from __future__ import annotations

from collections.abc import Iterator

from lidar_protocol.errors import DecodeError, Fault

DELIMITER = b"\0"
_LONGEST_RUN = 254


def encode(data: bytes) -> bytes:
    """Stuff `data`; the delimiter is not included."""
    runs = data.split(DELIMITER)
    if len(data) >= _LONGEST_RUN and max(map(len, runs)) >= _LONGEST_RUN:
        return b"".join([bytes((len(run) + 1,)) + run for run in _cut(runs)])
    stuffed = bytearray(DELIMITER + data)  # one byte more, and every zero becomes a code
    position = 0
    for run in runs:
        stuffed[position] = code = len(run) + 1
        position += code
    return bytes(stuffed)


def _cut(runs: list[bytes]) -> Iterator[bytes]:
    """Split runs to at most 254 bytes. A full run implies no zero: a zero after it needs a code of its own."""
    *inner, last = runs
    for run in inner:
        full = len(run) // _LONGEST_RUN * _LONGEST_RUN
        yield from (run[start : start + _LONGEST_RUN] for start in range(0, full, _LONGEST_RUN))
        yield run[full:]
    yield from (last[start : start + _LONGEST_RUN] for start in range(0, max(1, len(last)), _LONGEST_RUN))


def decode(stuffed: bytes) -> bytes:
    """Decode one frame without its delimiter.

    Raises:
        DecodeError: the frame is empty, contains a zero, or ends inside a run.
    """
    if not stuffed or DELIMITER in stuffed:
        raise DecodeError(Fault.BAD_STUFFING, "a frame is at least one byte, none of them zero")
    if len(stuffed) > _LONGEST_RUN:
        return _decode_long(stuffed)
    data = bytearray(stuffed)
    position, end = 0, len(stuffed)
    while position < end:
        code = data[position]
        data[position] = 0
        position += code
    _check_end(position, end)
    return bytes(data[1:])


def _decode_long(stuffed: bytes) -> bytes:
    """Decode a frame that may contain full runs, after which there is no zero."""
    data = bytearray(stuffed)
    position, end = 0, len(stuffed)
    not_in_data: list[int] = []
    while position < end:
        code = data[position]
        data[position] = 0
        position += code
        if code > _LONGEST_RUN:
            not_in_data.append(position)
    _check_end(position, end)
    for place in reversed(not_in_data):
        del data[place : place + 1]
    return bytes(data[1:])


def _check_end(position: int, end: int) -> None:
    if position > end:
        raise DecodeError(Fault.BAD_STUFFING, "the frame ends inside a run")


def stuffed_length(length: int) -> int:
    """Maximum stuffed length of `length` bytes, without the delimiter."""
    return length + 1 + max(0, length - 1) // _LONGEST_RUN

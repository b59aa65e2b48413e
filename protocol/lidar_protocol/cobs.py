"""Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999).

Stuffed bytes contain no zero, so that a zero can end each frame. Every run of up to 254 bytes without a zero
is preceded by a code byte: the distance to the next zero that was taken out, or 255 where none was.
"""

from __future__ import annotations

from lidar_protocol.errors import DecodeError, Fault

DELIMITER = b"\0"
_LONGEST_RUN = 254
_FULL = b"\xff"
_CODES = [bytes((length + 1,)) for length in range(_LONGEST_RUN + 1)]


def encode(data: bytes) -> bytes:
    """`data` stuffed, without the delimiter."""
    *inner, last = data.split(DELIMITER)
    pieces: list[bytes] = []
    for run in inner:
        while len(run) >= _LONGEST_RUN:  # a full run implies no zero: the zero needs a code of its own
            pieces += (_FULL, run[:_LONGEST_RUN])
            run = run[_LONGEST_RUN:]
        pieces += (_CODES[len(run)], run)
    while len(last) > _LONGEST_RUN:
        pieces += (_FULL, last[:_LONGEST_RUN])
        last = last[_LONGEST_RUN:]
    pieces += (_CODES[len(last)], last)
    return b"".join(pieces)


def decode(stuffed: bytes) -> bytes:
    """The data of one frame, given without its delimiter.

    Raises:
        DecodeError: the frame is empty, holds a zero, or ends inside a run.
    """
    if not stuffed or DELIMITER in stuffed:
        raise DecodeError(Fault.BAD_COBS, "a frame is at least one byte, none of them zero")
    pieces: list[bytes] = []
    position, end = 0, len(stuffed)
    while True:
        code = stuffed[position]
        following = position + code
        pieces.append(stuffed[position + 1 : following])
        if following >= end:
            break
        if code <= _LONGEST_RUN:
            pieces.append(DELIMITER)
        position = following
    if following > end:
        raise DecodeError(Fault.BAD_COBS, "the frame ends inside a run")
    return b"".join(pieces)


def stuffed_length(length: int) -> int:
    """The greatest number of bytes that `length` bytes become, without the delimiter."""
    return length + 1 + max(0, length - 1) // _LONGEST_RUN

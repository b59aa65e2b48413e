"""Serial line IP framing (RFC 1055): END closes a frame, and is escaped within it."""

from __future__ import annotations

from lidar_protocol.errors import DecodeError, Fault

DELIMITER = b"\xc0"
_ESCAPE, _ESCAPED_END, _ESCAPED_ESCAPE = b"\xdb", b"\xdb\xdc", b"\xdb\xdd"


def encode(data: bytes) -> bytes:
    """`data` stuffed, without the delimiter."""
    return data.replace(_ESCAPE, _ESCAPED_ESCAPE).replace(DELIMITER, _ESCAPED_END)


def decode(stuffed: bytes) -> bytes:
    """The data of one frame, given without its delimiter.

    Raises:
        DecodeError: the frame is empty, holds an END, or an escape that stands for nothing.
    """
    escapes = stuffed.count(_ESCAPE)
    known = stuffed.count(_ESCAPED_END) + stuffed.count(_ESCAPED_ESCAPE)
    if not stuffed or DELIMITER in stuffed or escapes != known:
        raise DecodeError(
            Fault.BAD_STUFFING, "a frame is at least one byte, with escapes of END and ESC alone"
        )
    return stuffed.replace(_ESCAPED_END, DELIMITER).replace(_ESCAPED_ESCAPE, _ESCAPE)


def stuffed_length(length: int) -> int:
    """The greatest number of bytes that `length` bytes become, without the delimiter."""
    return 2 * length

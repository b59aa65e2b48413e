"""Serial line IP framing (RFC 1055): END closes a frame, and is escaped within it."""

from __future__ import annotations

from lidar_protocol.errors import DecodeError, Fault

DELIMITER = b"\xc0"
_ESCAPE, _ESCAPED_END, _ESCAPED_ESCAPE = b"\xdb", b"\xdb\xdc", b"\xdb\xdd"


def encode(data: bytes) -> bytes:
    """Stuff `data`; the delimiter is not included."""
    return data.replace(_ESCAPE, _ESCAPED_ESCAPE).replace(DELIMITER, _ESCAPED_END)


def decode(stuffed: bytes) -> bytes:
    """Decode one frame without its delimiter.

    Raises:
        DecodeError: the frame is empty, contains an END, or an invalid escape sequence.
    """
    escapes = stuffed.count(_ESCAPE)
    known = stuffed.count(_ESCAPED_END) + stuffed.count(_ESCAPED_ESCAPE)
    if not stuffed or DELIMITER in stuffed or escapes != known:
        raise DecodeError(
            Fault.BAD_STUFFING, "a frame is at least one byte, with escapes of END and ESC alone"
        )
    return stuffed.replace(_ESCAPED_END, DELIMITER).replace(_ESCAPED_ESCAPE, _ESCAPE)


def stuffed_length(length: int) -> int:
    """Maximum stuffed length of `length` bytes, without the delimiter."""
    return 2 * length

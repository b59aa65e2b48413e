"""Framing of serial line IP (RFC 1055), for the code that Kaitai Struct's compiler writes from lidar.ksy."""

_ESCAPED = {b"\xdb\xdc": b"\xc0", b"\xdb\xdd": b"\xdb"}


class LidarSlip:
    """Process `lidar_slip`."""

    def decode(self, data: bytes) -> bytes:
        """Remove the stuffing of a frame without its delimiter; empty if an escape sequence is invalid."""
        if data.count(b"\xdb") != sum(data.count(sequence) for sequence in _ESCAPED):
            return b""
        for sequence, byte in _ESCAPED.items():
            data = data.replace(sequence, byte)
        return data

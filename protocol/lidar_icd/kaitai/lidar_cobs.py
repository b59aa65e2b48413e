"""Consistent overhead byte stuffing, for the code that Kaitai Struct's compiler writes from lidar.ksy."""


class LidarCobs:
    """Process `lidar_cobs`."""

    def decode(self, data: bytes) -> bytes:
        """Remove the stuffing of a frame without its delimiter; empty if there is no valid stuffing."""
        decoded, position = bytearray(), 0
        while position < len(data):
            code = data[position]
            end = position + code
            if code == 0 or end > len(data):
                return b""
            decoded += data[position + 1 : end]
            if code < 255 and end < len(data):
                decoded.append(0)
            position = end
        return bytes(decoded)

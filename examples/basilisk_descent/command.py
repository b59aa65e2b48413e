"""The command from the navigator to the vehicle: one datagram for each packet of the lidar."""

import struct
from typing import NamedTuple, Self

_LAYOUT = struct.Struct("<4sI3d")  # 32 bytes, little-endian: "NAVC", shot, thrust_body_mps2


class Command(NamedTuple):
    """Commanded thrust per mass, in the body axes at the time of the shot."""

    shot: int
    thrust_body_mps2: tuple[float, float, float]
    """Body x forward, y right, z down. All zero: engine off."""

    def to_bytes(self) -> bytes:
        """The datagram."""
        return _LAYOUT.pack(b"NAVC", self.shot, *self.thrust_body_mps2)

    @classmethod
    def from_bytes(cls, datagram: bytes) -> Self:
        """The inverse of `to_bytes`.

        Raises:
            ValueError: the datagram is not a command.
        """
        if len(datagram) != _LAYOUT.size or datagram[:4] != b"NAVC":
            raise ValueError("not a command of the navigator")
        _, shot, *thrust = _LAYOUT.unpack(datagram)
        return cls(shot, tuple(thrust))

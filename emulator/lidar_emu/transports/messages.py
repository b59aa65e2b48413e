"""Messages at the host's end of a link: what is received, and commands as the link takes them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict

from lidar_emu.transports.frames import Frame, pack_frames
from lidar_protocol import (
    Acknowledge,
    CanReceiver,
    Host,
    Housekeeping,
    Interface,
    Message,
    Received,
    SerialReceiver,
    default_interface,
)
from lidar_protocol.commands import Argument


class Decoder:
    """Decodes what a port receives into messages; counts bad bytes and frames."""

    def __init__(self, interface: Interface | None = None) -> None:
        self.interface = interface or default_interface()
        self._serial = SerialReceiver(self.interface)
        self._can = CanReceiver(self.interface) if self.interface.can else None
        self._kinds: Counter[type] = Counter()

    def decode(self, arrived: bytes | Iterable[Frame]) -> list[Message]:
        """The measurements completed by this data."""
        return [message for message in self.receive(arrived) if isinstance(message, Message)]

    def receive(self, arrived: bytes | Iterable[Frame]) -> list[Received]:
        """All messages completed by this data."""
        received: list[Received] = []
        if isinstance(arrived, bytes):
            received = self._serial.receive(arrived)
        elif self._can is not None:
            for frame in arrived:
                received += self._can.receive(frame.can_id, frame.data, frame.is_fd)
        self._kinds.update(type(message) for message in received)
        return received

    @property
    def messages(self) -> int:
        """Number of measurements received."""
        return self._kinds[Message]

    def counters(self) -> dict[str, int]:
        """All counters, good and bad. On CAN each frame of housekeeping counts."""
        is_can = self._can is not None and self._can.counters.frames > 0
        counters = self._can.counters if self._can is not None and is_can else self._serial.counters
        kinds = {"acknowledgements": self._kinds[Acknowledge], "housekeeping": self._kinds[Housekeeping]}
        return {**asdict(counters), **kinds}


def command_payload(host: Host, is_can: bool, name: str, values: Mapping[str, Argument]) -> bytes:
    """A command as bytes, on CAN as frame records.

    Raises:
        EncodeError: unknown command, or an argument is missing, unknown or cannot be encoded.
    """
    if not is_can:
        return host.encode_command(name, **values)
    frame = host.encode_command_frame(name, **values)
    return pack_frames([Frame(frame.can_id, frame.data)])

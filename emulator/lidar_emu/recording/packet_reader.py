"""Read packets and their delivery status from the messages of a recording."""

from __future__ import annotations

from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_emu.recording import channels
from lidar_emu.recording.json_messages import checked_values
from lidar_emu.recording.mcap_file import Damage, RecordedMessage
from lidar_emu.runtime.port.packets import DeliveryStatus

_CODES = {status.name.lower(): status.value for status in DeliveryStatus}


@dataclass(frozen=True)
class Deliveries:
    """Deliveries of packets in the order of their due times: arrays are (packets,)."""

    shot: NDArray[np.int64]
    due_ns: NDArray[np.int64]
    """Due time from the start of the run."""
    sent_ns: NDArray[np.int64]
    """Time at which the link had accepted the whole packet, from the start of the run; -1: not sent."""
    status: NDArray[np.int8]
    """Delivery status, a `DeliveryStatus`."""
    overtaken: NDArray[np.bool_]
    """Whether the packet was sent before the device had processed a command that affects its shot."""

    def __len__(self) -> int:
        return len(self.shot)


@dataclass(frozen=True)
class Packets(Deliveries):
    """Packets with their deliveries."""

    payload: list[bytes]
    """Bytes as on the link, on CAN frame records; empty where suppressed, or too late to be computed."""


class DeliveryReader:
    """Reader of deliveries; one that is damaged is left out.

    Args:
        damage: where messages that cannot be read are counted.
    """

    topics: tuple[str, ...] = (channels.DELIVERY.topic,)

    def __init__(self, damage: Damage) -> None:
        self._damage = damage
        self._rows = array("q")

    def add(self, message: RecordedMessage) -> None:
        """Take a message of these topics, in the order of the file."""
        self._add_delivery(message)

    def deliveries(self) -> Deliveries:
        """The deliveries taken so far."""
        return Deliveries(*self._columns())

    def _add_delivery(self, message: RecordedMessage) -> bool:
        delivery = checked_values(message, channels.DELIVERY, self._damage)
        if delivery is None:
            return False
        sent_ns = -1 if delivery["sent_ns"] is None else delivery["sent_ns"]
        status = _CODES.get(delivery["status"])
        try:
            row = array("q", (delivery["shot"], delivery["due_ns"], sent_ns, status, delivery["overtaken"]))
        except (TypeError, OverflowError):  # an unknown status, or a number beyond 64 bits
            self._damage.add_message(message)
            return False
        self._rows.extend(row)
        return True

    def _columns(
        self,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int8], NDArray[np.bool_]]:
        rows = np.array(self._rows, dtype=np.int64).reshape(-1, 5)
        shot, due_ns, sent_ns, status, overtaken = rows.T.copy()
        return shot, due_ns, sent_ns, status.astype(np.int8), overtaken.astype(np.bool_)


class PacketReader(DeliveryReader):
    """Reader of packets with their deliveries."""

    topics = (channels.PACKET.topic, channels.DELIVERY.topic)

    def __init__(self, damage: Damage) -> None:
        super().__init__(damage)
        self._payloads: list[bytes] = []
        self._packet: RecordedMessage | None = None

    def add(self, message: RecordedMessage) -> None:
        """Take a message of these topics, in the order of the file."""
        if message.topic == channels.PACKET.topic:
            self._packet = message
            return
        if self._add_delivery(message):
            # A packet of another shot is one whose own delivery is lost.
            is_its_own = self._packet is not None and self._packet.sequence == message.sequence
            self._payloads.append(self._packet.data if self._packet is not None and is_its_own else b"")
        self._packet = None

    def packets(self) -> Packets:
        """The packets taken so far."""
        return Packets(*self._columns(), self._payloads)

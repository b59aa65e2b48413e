"""A simulated CAN adapter without a descriptor: frames take time, its buffer fills, and it is unplugged."""

from __future__ import annotations

import errno
from collections import deque
from typing import Any

from can import CanOperationError, Message

from lidar_emu.errors import InputError
from lidar_emu.transports.can_adapters import frame_of, message_of
from lidar_emu.transports.can_port import CanChannel
from lidar_emu.transports.frames import Frame, unpack_frames
from lidar_emu.transports.spec import frame_bits
from lidar_protocol import CanFrame
from simulated_runtime.ledger import require
from simulated_runtime.line import Connection, Line
from simulated_runtime.scheduler import Scheduler

_ROOM_FRAMES = 24


class SimulatedBus(Line):
    """A bus of which one adapter sends and receives.

    Args:
        bitrate: bits per second; 0: bits take no time.
    """

    def __init__(self, scheduler: Scheduler, bitrate: int) -> None:
        super().__init__(scheduler)
        self._bit_ns = 10**9 / bitrate if bitrate else 0.0
        self.queue: deque[Frame] = deque()
        self.owed: deque[Frame] = deque()
        """Frames of a set of which the adapter has taken some."""
        self.offered: deque[Frame] = deque()
        self.frames: list[Frame] = []
        """Frames that have reached the host."""
        self._arrived: deque[Message] = deque()

    # The adapter, as python-can's

    def fileno(self) -> int:
        raise NotImplementedError

    def send(self, message: Message, timeout: float) -> None:  # noqa: ARG002
        if self.dead:
            raise CanOperationError("No such device", errno.ENODEV)
        if len(self.queue) >= _ROOM_FRAMES or self._scheduler.random.random() < 0.01:
            raise CanOperationError("buffer full", errno.ENOBUFS)
        frame = frame_of(message)
        self.owed = self.owed or self.offered
        require(frame == self.owed.popleft(), "torn: a frame of another set", frame)
        self.queue.append(frame)
        self._drain()

    def recv(self, timeout: float) -> Message | None:  # noqa: ARG002
        if self.dead:
            raise CanOperationError("No such device", errno.ENODEV)
        if not self._arrived:
            return None
        return self._arrived.popleft()

    def shutdown(self) -> None:
        self._disconnect()
        self.queue.clear()

    # The world's side

    def open(self) -> Connection:
        if not self.present:
            raise InputError("--channel", None, "simulated", "there is no such device")
        self.owed, self.offered = deque(), deque()
        self._arrived.clear()
        return self._connect()

    def unplug(self) -> None:
        super().unplug()
        self.queue.clear()

    def command(self, frame: CanFrame) -> None:
        if self.is_open and not self.dead:
            self._arrived.append(message_of(Frame(frame.can_id, frame.data)))

    def send_bytes(self, data: bytes) -> None:
        # Frames of another node.
        for k in range(0, len(data), 8):
            self.command(CanFrame(0x700 + k % 0x80, data[k : k + 8]))

    def _drain(self) -> None:
        if self._is_draining or not self.queue:
            return
        self._is_draining = True
        begins_ns = max(self._scheduler.now_ns, self._stalled_ns)
        bits = frame_bits(self.queue[0])[0]
        self._scheduler.at(begins_ns + int(bits * self._bit_ns), self._deliver)

    def _deliver(self) -> None:
        self._is_draining = False
        if self._stalled_ns <= self._scheduler.now_ns and self.queue:
            self.frames.append(self.queue.popleft())
        self._drain()


class SimulatedCan(CanChannel):
    """The channel of a bus, over a simulated adapter."""

    def __init__(self, bus: SimulatedBus) -> None:
        self._connection = bus.open()
        adapter: Any = bus
        super().__init__(adapter, "simulated bus")
        self._simulated = bus

    def send(self, payload: bytes) -> bool:
        self._simulated.offered = deque(unpack_frames(payload))
        taken = super().send(payload)
        if taken:
            self._simulated.take(self._connection, payload)
        return taken

"""A simulated line between the device and its host: bytes take time, and the line can be full, stalled or dead."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from lidar_emu.errors import InputError
from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.link import LinkLostError, PortChannel
from simulated_runtime.ledger import require
from simulated_runtime.scheduler import Scheduler

_ROOM_BYTES = 4096
_CHUNK_BYTES = 256
_WAKE_BYTES = 256
"""A tty is writable once it holds less, WAKEUP_CHARS of Linux, though it takes bytes before."""
_FLOOD_BYTES, _FLOOD_NS = 920, 10_000_000


@dataclass
class Connection:
    """What passed while the port was open once."""

    opened_ns: int
    plugged_ns: int
    """Since when there had been another end."""
    closed_ns: int = 0
    taken: list[bytes] = field(default_factory=list)
    """Payloads of which the channel took at least a part, in whole."""
    taken_ns: list[int] = field(default_factory=list)
    written: bytearray = field(default_factory=bytearray)
    """Bytes that the line took."""
    delivered: bytearray = field(default_factory=bytearray)
    """Bytes that have reached the host."""
    discarded: int = 0
    """Bytes that a reader that hung up has left."""
    lost: bool = False
    """Whether it ended by a break."""
    cut: bool = False
    """Whether bytes were still in the line when the port was closed."""


class Line:
    """What lines of all kinds have in common: they are unplugged, and stall."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self.connections: list[Connection] = []
        self.is_open = self.is_pty = False
        self.present = True
        self.dead = False
        self.received_bytes = self._plugged_ns = self.read_ns = 0
        self._stalled_ns = 0
        self._is_draining = False

    def stall(self, duration_ns: int) -> None:
        """Deliver nothing for a while."""
        self._stalled_ns = max(self._stalled_ns, self._scheduler.now_ns + duration_ns)

    def send_bytes(self, data: bytes) -> None:
        """Bytes of the host."""
        raise NotImplementedError

    def flood(self, ends_ns: int) -> None:
        """Let the host send noise as fast as a line takes it."""
        if self._scheduler.now_ns < ends_ns:
            self.send_bytes(self._scheduler.random.randbytes(_FLOOD_BYTES))
            self._scheduler.at(self._scheduler.now_ns + _FLOOD_NS, lambda: self.flood(ends_ns))

    def unplug(self) -> None:
        """Remove the other end; of a pty, its reader."""
        self.present = False
        if self.is_open and not self.is_pty:
            self.dead = True
            self.connections[-1].lost = True

    def plug(self) -> None:
        """Bring the other end back."""
        self.present = True
        self._plugged_ns = self._scheduler.now_ns

    def take(self, connection: Connection, payload: bytes) -> None:
        """A channel took a payload."""
        connection.taken.append(payload)
        connection.taken_ns.append(self._scheduler.now_ns)

    def _connect(self) -> Connection:
        self.connections.append(Connection(self._scheduler.now_ns, self._plugged_ns))
        self.is_open, self.dead = True, False
        return self.connections[-1]

    def _disconnect(self) -> None:
        self.connections[-1].closed_ns = self._scheduler.now_ns
        self.is_open = False


class SimulatedLine(Line):
    """A serial line: a buffer of the system that empties at the bit rate.

    Args:
        baud: bits per second; 0: bits take no time.
        descriptor_of: gives a device a descriptor.
    """

    def __init__(self, scheduler: Scheduler, baud: int, descriptor_of: Callable[[object], int]) -> None:
        super().__init__(scheduler)
        self._byte_ns = 10 * 10**9 / baud if baud else 0.0
        self.descriptor = descriptor_of(self)
        self.queued = bytearray()
        self.incoming = bytearray()
        self.owed = b""
        """The rest of a payload of which the line has taken a part."""
        self._waits_for_reader = False
        """A pty of Linux that is full takes nothing until its reader has fetched nearly all."""

    # The system's side

    def open(self) -> Connection:
        if not (self.present or self.is_pty):
            raise InputError("--port", None, "simulated", "there is no such port")
        self.queued.clear()
        self.incoming.clear()
        self.owed, self._waits_for_reader = b"", False
        return self._connect()

    def close(self) -> None:
        # The driver of a closed line discards what has not left it.
        self.connections[-1].cut |= bool(self.queued or self.owed)
        self._disconnect()
        self.queued.clear()

    def discard(self) -> None:
        """Drop what the reader has not fetched."""
        self.connections[-1].discarded += len(self.queued) + len(self.owed)
        self.owed = b""
        self.queued.clear()

    def is_readable(self) -> bool:
        return self.dead or bool(self.incoming)

    def is_writable(self) -> bool:
        return self.dead or len(self.queued) < _WAKE_BYTES

    def write(self, data: bytes) -> int:
        if self.dead:
            raise LinkLostError("the other end has gone")
        self._waits_for_reader &= len(self.queued) >= _WAKE_BYTES
        room = 0 if self._waits_for_reader else min(len(data), _ROOM_BYTES - len(self.queued))
        self._waits_for_reader |= self.is_pty and room == 0
        if room > 1 and self._scheduler.random.random() < 0.05:
            room = self._scheduler.random.randrange(room)
        require(
            not self.owed or data == self.owed, "torn: another payload in the midst of one", data, self.owed
        )
        self.owed = data[room:] if room or self.owed else b""
        self.queued += data[:room]
        self.connections[-1].written += data[:room]
        self._drain()
        return room

    def read(self, most: int) -> bytes:
        if self.dead:
            raise LinkLostError("the other end has gone")
        data = bytes(self.incoming[:most])
        del self.incoming[:most]
        if data:
            self.received_bytes += len(data)
            self.read_ns = self._scheduler.now_ns
        return data

    # The world's side

    def unplug(self) -> None:
        super().unplug()
        if self.dead:
            self.queued.clear()

    def send_bytes(self, data: bytes) -> None:
        if self.is_open and not self.dead:
            self.incoming += data[: _ROOM_BYTES - len(self.incoming)]

    def _drain(self) -> None:
        if self._is_draining or not self.queued:
            return
        self._is_draining = True
        count = min(len(self.queued), _CHUNK_BYTES)
        begins_ns = max(self._scheduler.now_ns, self._stalled_ns)
        self._scheduler.at(begins_ns + int(count * self._byte_ns), lambda: self._deliver(count))

    def _deliver(self, count: int) -> None:
        self._is_draining = False
        if self._stalled_ns <= self._scheduler.now_ns:
            self.connections[-1].delivered += self.queued[:count]
            del self.queued[:count]
        self._drain()


class SimulatedSerial(DescriptorChannel):
    """The channel of a serial device, over a simulated line instead of a descriptor."""

    def __init__(self, line: SimulatedLine) -> None:
        PortChannel.__init__(self, "simulated line")
        self._line, self._connection = line, line.open()
        self._descriptor = self._input = line.descriptor
        self._rest = b""

    def send(self, payload: bytes) -> bool:
        taken = super().send(payload)
        if taken:
            self._line.take(self._connection, payload)
        return taken

    def receive(self) -> bytes:
        return self._read() if self._line.is_readable() else b""

    def unread(self) -> int:
        return len(self._rest) + len(self._line.queued)

    def close(self) -> None:
        self._line.close()

    def _write(self, data: bytes) -> int:
        return self._line.write(data)

    def _read(self) -> bytes:
        return self._line.read(4096)


class SimulatedPty(SimulatedSerial):
    """The channel of a pseudo-terminal, whose reader comes and goes."""

    def __init__(self, line: SimulatedLine) -> None:
        line.is_pty = True
        super().__init__(line)
        self._had_reader = False

    def connected(self) -> bool:
        present = self._line.present
        if not present and self._had_reader:
            # Unread bytes are stale for the next reader, which starts with a whole packet.
            self._line.discard()
            self._rest = b""
        self._had_reader = present
        return present

    def send(self, payload: bytes) -> bool:
        return (self._had_reader or self.connected()) and super().send(payload)

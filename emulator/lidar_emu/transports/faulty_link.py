"""A port on which things go wrong by order: it breaks, is slow, babbles, or has errors on its bus.

Whatever stands between a packet and the line sits here as one more channel, so that the link above sees no more than it
would of a real fault: a port that is lost, cannot be opened, or is full.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Any

from lidar_emu.errors import InputError
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_emu.transports.link import Channel, LinkDiagnostics, LinkLostError
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_emu.transports.wire_load import SERIAL_BITS_PER_BYTE, frame_bits

_BREAKS = {"disconnect": "disconnected, as ordered", "bus_off": "bus off, as ordered"}
_CAN_DATA_BYTES = 8
_CAN_IDS = 0x800
_MOST_BABBLE_BYTES = 1024
"""At once: what was due while nothing could be written is not made up for."""


@dataclass(frozen=True)
class PortFault:
    """A fault of the port, as its process is told."""

    number: int
    """Its place in the scenario's list."""
    kind: str
    from_ns: int
    """Scenario time."""
    to_ns: int | None
    """None: no end."""
    seed: int = 0
    rate: float = 0.0
    """Bits, bytes or error frames per second."""
    buffer_bytes: int = 0

    def acts(self, time_ns: int) -> bool:
        """Whether it is its time."""
        return self.from_ns <= time_ns and (self.to_ns is None or time_ns < self.to_ns)

    def due(self, time_ns: int) -> int:
        """Of what comes at a rate, how much has come by then."""
        end_ns = time_ns if self.to_ns is None else min(time_ns, self.to_ns)
        return max(0, int(self.rate * (end_ns - self.from_ns) * 1e-9))

    def noise(self, first: int, end: int) -> bytes:
        """Bytes `first` to `end - 1` of its babble: the same whenever they are asked for."""
        blocks = range(first // 64, -(-end // 64))
        data = b"".join(blake2b(b"%d %d %d" % (self.seed, self.number, block)).digest() for block in blocks)
        return data[first % 64 :][: end - first]


class FaultyPort:
    """Opens a port, and opens it again, as far as the faults let it.

    Args:
        open_channel: opens the port itself.
        spec: which it is.
        now_ns: instant of the monotonic clock.
    """

    def __init__(
        self, open_channel: Callable[[], Channel], spec: PortSpec, now_ns: Callable[[], int]
    ) -> None:
        self._open = open_channel
        self._now_ns = now_ns
        self._start_ns: int | None = None
        self.is_can = spec.kind is Kind.CAN
        # What is lost there does not come back: its line goes dead instead.
        self._keeps = spec.kind in (Kind.PTY, Kind.LOOPBACK) or spec.path.startswith("/dev/pts/")
        self._kept: Channel | None = None
        self.orders: list[PortFault] = []
        self._told: dict[int, int] = {}

    def begin(self, start_ns: int) -> None:
        """Scenario time 0 is at this instant of the monotonic clock; before, nothing goes wrong."""
        self._start_ns = start_ns

    def order(self, order: dict[str, Any]) -> None:
        """One more fault."""
        self.orders.append(PortFault(**order))

    def __call__(self) -> Channel:
        """Open the port.

        Raises:
            InputError: it cannot be opened.
        """
        broken = self.broken()
        if broken is not None:
            raise InputError("--port", None, _BREAKS[broken.kind], "allowed: once that is over")
        if self._kept is None:
            return FaultyChannel(self, self._open())
        channel, self._kept = self._kept, None
        while channel.receive():  # nobody heard it
            continue
        return FaultyChannel(self, channel)

    def broken(self) -> PortFault | None:
        """The fault that has the port broken, if there is one."""
        return next((order for order in self.acting("disconnect", "bus_off")), None)

    def acting(self, *kinds: str) -> list[PortFault]:
        """The faults of these kinds that act now."""
        time_ns = self.time_ns
        return [order for order in self.orders if order.kind in kinds and order.acts(time_ns)]

    def news(self, order: PortFault) -> tuple[int, int]:
        """Of what comes at a rate: how much had come at the last call, and how much has by now."""
        before, now = self._told.get(order.number, 0), order.due(self.time_ns)
        self._told[order.number] = now
        return before, now

    @property
    def time_ns(self) -> int:
        """Scenario time; -1 before it begins."""
        return -1 if self._start_ns is None else self._now_ns() - self._start_ns

    def give_back(self, channel: Channel) -> None:
        """A channel that is no longer used: closed, unless it could never be opened again."""
        broken = self.broken()
        if broken is not None and (self._keeps or broken.kind == "bus_off"):
            self._kept = channel
        else:
            channel.close()


class FaultyChannel:
    """A channel behind a port's faults. It is looked after every millisecond while something waits in it."""

    def __init__(self, port: FaultyPort, channel: Channel) -> None:
        self.description = channel.description
        self._port, self._channel = port, channel
        self._buffer: deque[tuple[int, bytes]] = deque()

    @property
    def pending(self) -> bool:
        """Whether a packet is partly written, or waits for its time."""
        return self._is_busy or self._channel.pending

    @property
    def readable(self) -> int | None:
        """Descriptor to wait on for something to `receive`."""
        return self._channel.readable

    @property
    def writable(self) -> int | None:
        """Descriptor to wait on for room; none where it is time that is waited for."""
        return None if self._is_busy else self._channel.writable

    def connected(self) -> bool:
        """Whether somebody is at the other end, as far as can be known."""
        self._break()
        return self._channel.connected()

    def send(self, payload: bytes) -> bool:
        """Take the whole packet (True) or nothing of it (False: the line is full)."""
        self._break()
        slow = self._port.acting("slow_line")
        if not (slow or self._buffer):
            return self._channel.send(payload)
        waiting = sum(len(packet) for _, packet in self._buffer)
        if slow and waiting + len(payload) > min(order.buffer_bytes for order in slow):
            return False
        free_ns = max(self._port.time_ns, self._buffer[-1][0] if self._buffer else 0)
        wire_s = max((self._bits(payload) / order.rate for order in slow), default=0.0)
        self._buffer.append((free_ns + round(wire_s * 1e9), payload))
        return True

    def flush(self) -> bool:
        """Let out what it is time for; True if nothing is left."""
        self._break()
        self._babble()
        while self._buffer and self._buffer[0][0] <= self._port.time_ns:
            if not self._channel.send(self._buffer[0][1]):
                return False
            self._buffer.popleft()
        return self._channel.flush() and not self._buffer

    def receive(self) -> bytes:
        """What has arrived (CAN: frame records); empty if nothing."""
        self._break()
        return self._channel.receive()

    def take_diagnostics(self) -> LinkDiagnostics:
        """What was noticed since the last call, ordered error frames among it."""
        noticed = self._channel.take_diagnostics()
        errors = 0
        for order in self._port.orders:
            if order.kind == "error_frames" and self._port.time_ns >= 0:
                before, now = self._port.news(order)
                errors += now - before
        # Not added to what the channel gave: NOTHING is everybody's.
        return replace(noticed, counts=noticed.counts + Counter(error_frames=errors)) if errors else noticed

    def unread(self) -> int:
        """Bytes taken that have not left the line or, on a pty, were not fetched by its reader."""
        return self._channel.unread() + sum(len(packet) for _, packet in self._buffer)

    def close(self) -> None:
        """Give the port back; never raises."""
        self._port.give_back(self._channel)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._channel, name)

    @property
    def _is_busy(self) -> bool:
        return bool(self._buffer or self._port.acting("babble"))

    def _break(self) -> None:
        broken = self._port.broken()
        if broken is not None:
            raise LinkLostError(_BREAKS[broken.kind])

    def _babble(self) -> None:
        for order in self._port.acting("babble"):
            first, end = self._port.news(order)
            first = max(first, end - _MOST_BABBLE_BYTES)
            if self._port.is_can:
                first, end = (place - place % _CAN_DATA_BYTES for place in (first, end))
            if first < end:
                # Where there is no room it is lost.
                self._channel.send(self._babble_of(order, first, end))

    def _babble_of(self, order: PortFault, first: int, end: int) -> bytes:
        noise = order.noise(first, end)
        if not self._port.is_can:
            return noise
        blocks = [noise[k : k + _CAN_DATA_BYTES] for k in range(0, len(noise), _CAN_DATA_BYTES)]
        return pack_frames(Frame(int.from_bytes(data[:2], "big") % _CAN_IDS, data) for data in blocks)

    def _bits(self, payload: bytes) -> int:
        if not self._port.is_can:
            return SERIAL_BITS_PER_BYTE * len(payload)
        return sum(sum(frame_bits(frame)) for frame in unpack_frames(payload))

"""A port with injected faults: disconnection, bus-off, a slow line, babble, or error frames.

The faults act in a channel between link and port, so that the link sees the same as with a real fault: a port that is
lost, cannot be opened, or is full.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Any

from lidar_emu.errors import Finding, InputError
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_emu.transports.link import LinkDiagnostics, LinkLostError, PortChannel
from lidar_emu.transports.spec import Kind, PortSpec, frame_bits

_BREAKS = {"disconnect": "disconnected by an injected fault", "bus_off": "bus off by an injected fault"}
_CAN_DATA_BYTES = 8
_CAN_IDS = 0x800
BUFFER_BYTES = 4096
"""Transmit buffer of a slow line."""
_MOST_BABBLE_BYTES = 1024
"""Largest number of bytes at once: babble that was due while nothing could be written is skipped."""


@dataclass(frozen=True)
class PortFault:
    """A fault of the port, as the port process receives it."""

    number: int
    """Index in the scenario's list of faults."""
    kind: str
    from_ns: int
    """Scenario time."""
    to_ns: int | None
    """None: no end."""
    seed: int = 0
    rate: float = 0.0
    """Bits, bytes or error frames per second."""

    def acts(self, time_ns: int) -> bool:
        """Whether it acts at this scenario time."""
        return self.from_ns <= time_ns and (self.to_ns is None or time_ns < self.to_ns)

    def due(self, time_ns: int) -> int:
        """Number of bytes or error frames up to a scenario time, at the rate of the fault."""
        end_ns = time_ns if self.to_ns is None else min(time_ns, self.to_ns)
        return max(0, int(self.rate * (end_ns - self.from_ns) * 1e-9))

    def noise(self, first: int, end: int) -> bytes:
        """Bytes `first` to `end - 1` of its babble: a function of seed and fault alone."""
        blocks = range(first // 64, -(-end // 64))
        data = b"".join(blake2b(b"%d %d %d" % (self.seed, self.number, block)).digest() for block in blocks)
        return data[first % 64 :][: end - first]


class FaultyPort:
    """Opens and reopens a port, unless a fault holds it broken.

    Args:
        now_ns: instant of the monotonic clock.
    """

    def __init__(
        self, open_channel: Callable[[], PortChannel], spec: PortSpec, now_ns: Callable[[], int]
    ) -> None:
        self._open = open_channel
        self._now_ns = now_ns
        self._start_ns: int | None = None
        self.is_can, self.bits_per_byte = spec.kind is Kind.CAN, spec.bits_per_byte
        # These ports cannot be reopened: the line goes dead instead.
        self._keeps = spec.kind in (Kind.PTY, Kind.LOOPBACK) or spec.path.startswith("/dev/pts/")
        self._kept: PortChannel | None = None
        self.faults: list[PortFault] = []
        self._counted: dict[int, int] = {}

    def begin(self, start_ns: int) -> None:
        """Set scenario time 0 to this instant of the monotonic clock; before it, no fault acts."""
        self._start_ns = start_ns

    def add(self, fault: dict[str, Any]) -> None:
        """Add a fault, a `PortFault` as a mapping."""
        self.faults.append(PortFault(**fault))

    def __call__(self) -> PortChannel:
        """Open the port.

        Raises:
            InputError: it cannot be opened.
        """
        broken = self.broken()
        if broken is not None:
            raise InputError("--port", None, Finding(_BREAKS[broken.kind]), "wait until the fault has ended")
        if self._kept is None:
            return FaultyChannel(self, self._open())
        channel, self._kept = self._kept, None
        while channel.receive():  # bytes that arrived in the meantime are lost
            continue
        return FaultyChannel(self, channel)

    def broken(self) -> PortFault | None:
        """The fault that holds the port broken; None if there is none."""
        return next((fault for fault in self.acting("disconnect", "bus_off")), None)

    def acting(self, *kinds: str) -> list[PortFault]:
        """The faults of these kinds that act now."""
        time_ns = self.time_ns
        return [fault for fault in self.faults if fault.kind in kinds and fault.acts(time_ns)]

    def new_count(self, fault: PortFault) -> tuple[int, int]:
        """Number of bytes or error frames up to the last call, and up to now."""
        before, now = self._counted.get(fault.number, 0), fault.due(self.time_ns)
        self._counted[fault.number] = now
        return before, now

    @property
    def time_ns(self) -> int:
        """Scenario time; -1 before it begins."""
        return -1 if self._start_ns is None else self._now_ns() - self._start_ns

    def release(self, channel: PortChannel) -> None:
        """Close a channel that is no longer used, or keep it if it could not be reopened."""
        broken = self.broken()
        if broken is not None and (self._keeps or broken.kind == "bus_off"):
            self._kept = channel
        else:
            channel.close()


class FaultyChannel(PortChannel):
    """A channel with the faults of a port; serviced every millisecond while packets wait in it."""

    def __init__(self, port: FaultyPort, channel: PortChannel) -> None:
        super().__init__(channel.description)
        self.driver_features = channel.driver_features
        self._port, self._channel = port, channel
        self._buffer: deque[tuple[int, bytes]] = deque()

    @property
    def pending(self) -> bool:
        return self._is_busy or self._channel.pending

    @property
    def readable(self) -> int | None:
        return self._channel.readable

    @property
    def writable(self) -> int | None:
        return None if self._is_busy else self._channel.writable

    def connected(self) -> bool:
        self._raise_if_broken()
        return self._channel.connected()

    def send(self, payload: bytes) -> bool:
        self._raise_if_broken()
        slow = self._port.acting("slow_line")
        if not (slow or self._buffer):
            return self._channel.send(payload)
        waiting = sum(len(packet) for _, packet in self._buffer)
        if slow and waiting + len(payload) > BUFFER_BYTES:
            return False
        free_ns = max(self._port.time_ns, self._buffer[-1][0] if self._buffer else 0)
        wire_s = max((self._bits(payload) / fault.rate for fault in slow), default=0.0)
        self._buffer.append((free_ns + round(wire_s * 1e9), payload))
        return True

    def flush(self) -> bool:
        self._raise_if_broken()
        self._babble()
        while self._buffer and self._buffer[0][0] <= self._port.time_ns:
            if not self._channel.send(self._buffer[0][1]):
                return False
            self._buffer.popleft()
        return self._channel.flush() and not self._buffer

    def receive(self) -> bytes:
        self._raise_if_broken()
        return self._channel.receive()

    def set_pulse(self, level: bool) -> None:
        if self._port.broken() is None:
            self._channel.set_pulse(level)

    def take_diagnostics(self) -> LinkDiagnostics:
        diagnostics = self._channel.take_diagnostics()
        errors = 0
        for fault in self._port.faults:
            if fault.kind == "error_frames" and self._port.time_ns >= 0:
                before, now = self._port.new_count(fault)
                errors += now - before
        if not errors:
            return diagnostics
        # Not added to the channel's object: NOTHING is shared.
        return replace(diagnostics, counts=diagnostics.counts + Counter(error_frames=errors))

    def unread(self) -> int:
        return self._channel.unread() + sum(len(packet) for _, packet in self._buffer)

    def close(self) -> None:
        self._port.release(self._channel)

    @property
    def _is_busy(self) -> bool:
        return bool(self._buffer or self._port.acting("babble"))

    def _raise_if_broken(self) -> None:
        broken = self._port.broken()
        if broken is not None:
            raise LinkLostError(_BREAKS[broken.kind])

    def _babble(self) -> None:
        for fault in self._port.acting("babble"):
            first, end = self._port.new_count(fault)
            first = max(first, end - _MOST_BABBLE_BYTES)
            if self._port.is_can:
                first, end = (place - place % _CAN_DATA_BYTES for place in (first, end))
            if first < end:
                noise = fault.noise(first, end)
                if self._port.is_can:
                    blocks = [noise[k : k + _CAN_DATA_BYTES] for k in range(0, len(noise), _CAN_DATA_BYTES)]
                    ids = [int.from_bytes(data[:2], "big") % _CAN_IDS for data in blocks]
                    noise = pack_frames(map(Frame, ids, blocks))
                # Without room it is lost.
                self._channel.send(noise)

    def _bits(self, payload: bytes) -> int:
        if not self._port.is_can:
            return self._port.bits_per_byte * len(payload)
        return sum(sum(frame_bits(frame)) for frame in unpack_frames(payload))

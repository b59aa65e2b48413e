"""Requirements on every decoder of external bytes, for any bytes: it must not raise, must not buffer
more than the longest frame, and must read the good frame that follows. Each target is a function of the fuzzer's bytes.
"""

from __future__ import annotations

from collections.abc import Callable

from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.live_datagram import TRUTH_BYTES, Truth
from lidar_icd import example
from lidar_protocol import (
    CanCommandReader,
    CanReceiver,
    Command,
    CommandReader,
    Device,
    Host,
    Interface,
    Message,
    SerialReceiver,
    default_interface,
    packet,
    shipped_interface,
)
from lidar_protocol.headers import KINDS, Kind

_RAW = len(KINDS)


class _Bytes:
    """Bytes from the fuzzer, taken from the front; zeros once they are used up."""

    def __init__(self, data: bytes) -> None:
        self.rest = data

    def take(self, count: int) -> bytes:
        taken, self.rest = self.rest[:count], self.rest[count:]
        return taken.ljust(count, b"\0")

    def number(self) -> int:
        return self.take(1)[0]


def portions(data: bytes, interface: Interface) -> list[bytes]:
    """Stretches of a stream: raw bytes, or the body of a packet with correct header, CRC and framing, since no fuzzer
    guesses a CRC."""
    source, made = _Bytes(data), []
    longest_body = interface.maximum_packet_bytes - interface.link.overhead
    while source.rest:
        kind, length = source.number() % (_RAW + 1), source.number() % (longest_body + 1)
        body = source.take(length)
        if kind < _RAW and KINDS[kind] in _kinds(interface):
            sealed = packet.seal(interface.link, KINDS[kind], 0, source.number(), body)
            body = interface.link.framing.encode(sealed)
        made.append(body)
    return made


def _kinds(interface: Interface) -> set[Kind]:
    """The kinds of packets that an interface has."""
    has: dict[Kind, object] = {
        "measurement": interface.packet,
        "command": interface.commands,
        "acknowledge": interface.acknowledge,
        "housekeeping": interface.housekeeping,
    }
    return {kind for kind, definition in has.items() if definition is not None}


def serial(data: bytes) -> None:
    """Fuzz the host's end of a byte link."""
    for name in ("default", "altimeter"):
        interface = shipped_interface(name)
        receiver = SerialReceiver(interface)
        longest = interface.link.framing.longest_frame(interface.maximum_packet_bytes)
        for portion in portions(data, interface):
            receiver.receive(portion)
            assert receiver.buffered_bytes <= longest
        good = Device(interface).serial_bytes(*example.shot(interface))
        # A false frame header may consume as many bytes as it announces, but no more.
        received = [receiver.receive(good) for _ in range(2 + longest // len(good))]
        assert isinstance(received[-1][-1], Message)


def command(data: bytes) -> None:
    """Fuzz the device's end of a byte link."""
    for name in ("default", "altimeter"):
        interface = shipped_interface(name)
        if interface.commands is None:
            continue
        reader = CommandReader(interface)
        longest = interface.link.framing.longest_frame(interface.maximum_command_bytes)
        for portion in portions(data, interface):
            reader.feed(portion)
            assert reader.buffered_bytes <= longest
        good = Host(interface).encode_command("no_op", sequence=1)
        found = [reader.feed(good) for _ in range(2 + longest // len(good))]
        assert isinstance(found[-1][-1], Command)


def can(data: bytes) -> None:
    """Fuzz the host's end of a CAN bus."""
    interface = default_interface()
    assert interface.can is not None
    receiver, source = CanReceiver(interface), _Bytes(data)
    sets = {
        name: Device(interface).can_frames(name, example.HEADER, example.BEAMS) for name in interface.can.sets
    }
    most = sum(len(frames) for frames in sets.values())
    while source.rest:
        receiver.receive(*_frame(source))
        assert receiver.buffered_frames <= 16 * most
    for name, frames in sets.items():
        found = [message for _ in range(2) for frame in frames for message in receiver.receive(*frame[:3])]
        assert any(isinstance(message, Message) for message in found), name


def can_command(data: bytes) -> None:
    """Fuzz the device's end of a CAN bus."""
    interface = default_interface()
    reader, source = CanCommandReader(interface), _Bytes(data)
    while source.rest:
        reader.feed(*_frame(source))
    good = Host(interface).encode_command_frame("no_op", sequence=1)
    assert isinstance(reader.feed(good.can_id, good.data)[-1], Command)


def truth(data: bytes) -> None:
    """Fuzz the decoder of a simulator's datagrams, in lockstep and by the clock."""
    flown, source = LiveTrajectory(100_000_000), _Bytes(data)
    while source.rest:
        datagram = source.take(TRUTH_BYTES if source.number() else source.number())
        read = Truth.from_bytes(datagram)
        flown.accept(read, None if source.number() % 2 else 10_000_000 * source.number())
        if read is not None:
            assert Truth.from_bytes(read.to_bytes()) is not None
    assert sum(flown.verdicts.values()) <= len(data)


def _frame(source: _Bytes) -> tuple[int, bytes, bool]:
    """Identifier (near the interface's identifiers), data, and whether the frame is FD."""
    head, length = source.number(), source.number()
    is_fd = bool(length & 0x80)
    return 0x080 + head + 256 * source.number() % 0x700, source.take(length % 65), is_fd


TARGETS: dict[str, Callable[[bytes], None]] = {
    check.__name__: check for check in (serial, can, command, can_command, truth)
}

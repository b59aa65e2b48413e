"""Requirements on every kind of line. Subclasses choose the lines."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Protocol

from far_ends import FarEnd
from waiting import LIMIT_S

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.packets import OutgoingPacket, Pace
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.transports.link import DeliveryStatus, Link
from lidar_emu.transports.opening import opener

_TICK_NS, _MOMENT_NS = 20_000_000, 200_000
_AGES_NS = 3600 * 10**9
_MOST_PACKETS = 20_000
_DROPPED = {DeliveryStatus.DROPPED_FULL, DeliveryStatus.DROPPED_NOBODY, DeliveryStatus.DROPPED_BROKEN}


class Device(Protocol):
    """The end under test."""

    description: str
    received: bytes

    def send(self, payload: bytes) -> DeliveryStatus: ...
    def pump(self) -> None:
        """Let time pass."""

    def events(self) -> list[str]: ...
    def close(self) -> None: ...


Place = Callable[[FarEnd], Device]
"""Makes a device on the far end's line."""


class InThisProcess:
    """A link, and a clock that the test turns."""

    def __init__(self, far: FarEnd) -> None:
        self._link = Link(opener(far.spec, far.loopback_fd))
        self._now_ns = 0
        self._events: list[str] = []
        self.description = self._link.description
        self.received = b""

    def send(self, payload: bytes) -> DeliveryStatus:
        self._link.service(self._now_ns)
        return self._link.send(payload, self._now_ns)

    def pump(self) -> None:
        self._now_ns += _TICK_NS
        self._link.service(self._now_ns)
        self.received += self._link.receive(self._now_ns)

    def events(self) -> list[str]:
        self._events += [text for _, text in self._link.take_events()]
        return self._events

    def close(self) -> None:
        self._link.close()


class InAnother:
    """The port process of a run."""

    def __init__(self, far: FarEnd) -> None:
        self._runner = PortRunner(slots=16, packet_bytes=8192, keeps_received=True)
        try:
            self.description = self._runner.start(far.spec)
        except BaseException:
            self._runner.close()
            raise
        self._runner.begin(Clock().now_ns(), _AGES_NS, Pace.WALL)
        self._count = 0
        self.received = b""

    def send(self, payload: bytes) -> DeliveryStatus:
        assert self._runner.push(OutgoingPacket(self._count, 0, payload))
        self._count += 1
        while not (reports := self._runner.reports()):
            self._runner.wait(Clock().now_ns() + _MOMENT_NS)
        (report,) = reports
        return report.status

    def pump(self) -> None:
        self._runner.wait(Clock().now_ns() + _TICK_NS)
        self.received += b"".join(arrival.data for arrival in self._runner.take_received())

    def events(self) -> list[str]:
        return [event.text for event in self._runner.status.events]

    def close(self) -> None:
        self._runner.close()


@contextmanager
def opened(place: Place, far: FarEnd) -> Iterator[Device]:
    """A device on the far end's line, closed at the end."""
    device = place(far)
    try:
        yield device
    finally:
        device.close()


def until(device: Device, condition: Callable[[], bool]) -> None:
    """Let time pass until a condition holds."""
    deadline_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline_s, f"it did not happen; events: {device.events()}"
        device.pump()


def gets_through(device: Device, far: FarEnd, number: int) -> bool:
    """Whether this packet arrives, which is sent until it is taken."""
    if number not in far.numbers():
        device.send(far.packet(number))
        device.pump()
    return number in far.numbers()


class EveryLine:
    """The tests. `place` makes the device."""

    def test_packets_arrive_whole_and_in_order(self, place: Place, far: FarEnd) -> None:
        with opened(place, far) as device:
            far.attach(device.description)
            for number in range(3):  # what the narrowest of them holds without being read
                assert device.send(far.packet(number)) is DeliveryStatus.SENT
            until(device, lambda: far.numbers() == [0, 1, 2])

    def test_what_the_far_end_states_arrives(self, place: Place, far: FarEnd) -> None:
        with opened(place, far) as device:
            far.attach(device.description)
            until(device, lambda: gets_through(device, far, 0))  # some know their device by what it sends
            far.send(far.command())
            until(device, lambda: device.received == far.command())

    def test_a_slow_reader_costs_the_newest_packets_whole(self, place: Place, far: FarEnd) -> None:
        with opened(place, far) as device:
            far.attach(device.description)
            taken, dropped = [], 0
            for number in range(_MOST_PACKETS if far.fills else 200):
                status = device.send(far.packet(number))
                assert status in (DeliveryStatus.SENT, DeliveryStatus.DROPPED_FULL)
                if status is DeliveryStatus.SENT:
                    taken.append(number)
                elif (dropped := dropped + 1) == 20:
                    break
            assert (dropped == 20) is far.fills
            after = _MOST_PACKETS
            if far.fills:
                until(device, lambda: far.numbers() == taken)
            until(device, lambda: gets_through(device, far, after))
            arrived = [number for number in far.numbers() if number != after]
            assert arrived == taken if far.fills else arrived == sorted(set(arrived))

    def test_a_late_reader_starts_with_a_whole_packet(self, place: Place, far: FarEnd) -> None:
        with opened(place, far) as device:
            for number in range(3):
                device.send(far.packet(number))
                device.pump()
            far.attach(device.description)
            until(device, lambda: gets_through(device, far, 3))
            numbers = far.numbers()  # of the last packet, which was sent until it arrived, more may follow
            assert numbers == sorted(numbers)

    def test_a_far_end_may_be_killed_and_come_back(self, place: Place, far: FarEnd) -> None:
        with opened(place, far) as device:
            far.attach(device.description)
            until(device, lambda: gets_through(device, far, 0))
            far.disconnect()

            def is_noticed() -> bool:
                status = device.send(far.packet(1))
                return status in _DROPPED and bool(device.events())

            if far.reports_loss:
                until(device, is_noticed)
            else:
                assert [device.send(far.packet(1)) for _ in range(20)] == [DeliveryStatus.SENT] * 20
            if not far.can_reconnect:
                return
            far.reconnect()
            until(device, lambda: gets_through(device, far, 2))

    def test_close_gives_everything_back(
        self, place: Place, far: FarEnd, eventually: Callable[[Callable[[], object]], None]
    ) -> None:
        before = open_descriptors()
        with opened(place, far) as device:
            far.attach(device.description)
            device.send(far.packet(0))
        far.disconnect()
        eventually(lambda: open_descriptors() <= before)
        if not far.can_reconnect:
            return
        if far.outlives_device:
            far.reconnect()
        with opened(place, far) as device:
            far.attach(device.description)
            until(device, lambda: gets_through(device, far, 1))


def open_descriptors() -> set[str]:
    """Of this process."""
    return {entry.name for entry in Path("/proc/self/fd").iterdir()}


def closing(far: FarEnd) -> Iterator[FarEnd]:
    """The far end, closed at the end if it is not already."""
    yield far
    with suppress(OSError, AttributeError):
        far.close()

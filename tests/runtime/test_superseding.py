"""Packets that commands have changed, at the sender."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.exchange import SharedRing
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace, Pacing
from lidar_emu.runtime.port.sender import Sender


class Line:
    """Takes everything."""

    unread = 0

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def send(self, payload: bytes, now_ns: int) -> DeliveryStatus:  # noqa: ARG002
        self.sent.append(payload)
        return DeliveryStatus.SENT

    def add_event(self, text: str, now_ns: int) -> None:  # noqa: ARG002
        raise AssertionError(text)


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=4))
def test_of_each_shot_the_last_announcement_is_sent(commands: list[tuple[int, int]]) -> None:
    """Commands: the number of further shots announced before each, and how many shots back it takes effect."""
    packets, reports = (
        SharedRing(SharedRing.create(256, 64)),
        SharedRing(SharedRing.create(512, DeliveryReport.SIZE_BYTES)),
    )
    line = Line()
    sender = Sender(packets, reports, line, Clock(), 0, Pacing(Pace.MAX, 0))
    wanted: dict[int, int] = {}
    next_shot = 0
    for generation, (more, back) in enumerate([*commands, (6, 0)]):
        for _ in range(more):
            packets.push(OutgoingPacket(next_shot, 0, bytes((next_shot, generation)), generation).to_bytes())
            wanted[next_shot] = generation
            next_shot += 1
        next_shot = max(0, next_shot - back)
        sender.supersede(generation + 1, next_shot, packets.written)
        wanted = {shot: g for shot, g in wanted.items() if shot < next_shot}
    while not sender.step().for_packets:
        pass
    assert line.sent == [bytes(entry) for entry in sorted(wanted.items())]
    reported = [DeliveryReport.from_bytes(entry) for entry in iter(reports.pop, None)]
    assert (
        sum(report.sent_ns if report.status is DeliveryStatus.SUPERSEDED else 1 for report in reported)
        == packets.written
    )
    packets.close()
    reports.close()

"""Live truth in lockstep: the simulator sends truth and waits; it is answered with the packets due up to then."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from lidar_emu.runtime.feed.base import POLL_NS, Desk
from lidar_emu.runtime.feed.truth_source import Arrival, TruthSource
from lidar_emu.runtime.port.packets import Outgoing, Report
from lidar_emu.trajectory.live_datagram import Answer, AnsweredPacket, Truth, Verdict, answers

if TYPE_CHECKING:
    from lidar_emu.flight.flight import Flight

_LINGER_NS = 200_000_000


class LockstepFeed:
    """As fast as both can. What is sent depends on the truth alone: every shot lies between two truths.

    A truth that comes again gets its answer again, so that a simulator whose answer was lost can go on.
    """

    def __init__(self, desk: Desk, source: TruthSource, flight: Flight) -> None:
        self._desk = desk
        self._source = source
        self._flight = flight
        self._computed: deque[Outgoing] = deque()
        self._last_answer: list[Answer] = []
        self._begun = False
        self._ended = False

    def fly(self) -> None:
        """See `Feed`."""
        desk = self._desk
        while not (self._ended or desk.interrupted()):
            desk.outbox.wait(desk.clock.now_ns() + POLL_NS, [self._source.fileno()])
            desk.hear(0 if self._source.newest is None else self._source.newest.time_ns)
            for arrival in self._source.receive():
                self._answer(arrival)
            desk.outbox.settle()
        if self._begun:
            self._linger()
            self._source.tell()
            desk.finish()

    def _linger(self) -> None:
        """The last answer may have got lost, too."""
        ends_ns = self._desk.clock.now_ns() + _LINGER_NS
        while self._desk.clock.now_ns() < ends_ns and not self._desk.interrupted():
            self._desk.outbox.wait(ends_ns, [self._source.fileno()])
            for arrival in self._source.receive():
                self._answer(arrival)

    def _answer(self, arrival: Arrival) -> None:
        truth = arrival.truth
        if arrival.verdict is Verdict.ACCEPTED and truth is not None:
            self._last_answer = self._step(truth)
            self._source.answer(self._last_answer, arrival.sender)
        elif self._last_answer and arrival.verdict is Verdict.DUPLICATE:
            self._source.answer(self._last_answer, arrival.sender)
        else:
            time_ns = 0 if truth is None else truth.time_ns
            self._source.answer(answers(arrival.verdict, arrival.sequence, time_ns, ()), arrival.sender)

    def _step(self, truth: Truth) -> list[Answer]:
        if not self._begun:
            self._begun = True
            self._desk.begin(self._desk.clock.now_ns())
            self._source.begin(None)
            self._desk.session.pass_over(-(-truth.time_ns // self._flight.period_ns))
        self._source.tell()
        self._compute(truth.time_ns)
        self._ended = self._source.ended or self._desk.session.next_shot >= self._flight.shot_count
        packets = self._send(None if self._ended else truth.time_ns)
        return answers(Verdict.ACCEPTED, truth.sequence, truth.time_ns, packets)

    def _compute(self, time_ns: int) -> None:
        """Every shot that truth covers by now; one that could also be covered sooner never depends on it."""
        session = self._desk.session
        while (
            session.next_shot < self._flight.shot_count and self._flight.seen_ns(session.next_shot) <= time_ns
        ):
            while self._desk.changes.first is not None:
                self._desk.follow(None)
            block = session.shoot(1)
            assert block is not None
            self._computed.extend(self._desk.outbox.announce(block))

    def _send(self, up_to_ns: int | None) -> list[AnsweredPacket]:
        """What is due by then, or everything; returns it once the delivery status of each packet is known."""
        desk, reports = self._desk, list[Report]()
        pushed: list[Outgoing] = []
        while self._computed and (up_to_ns is None or self._computed[0].due_ns <= up_to_ns):
            while not desk.outbox.push(self._computed[0]) and not desk.interrupted():
                reports += desk.rest()
            pushed.append(self._computed.popleft())
        while not (desk.outbox.empty or desk.interrupted()):
            reports += desk.rest()
        return [
            AnsweredPacket(packet.shot, packet.due_ns, report.status, packet.payload)
            for packet, report in zip(
                pushed, reports, strict=False
            )  # fewer reports if the run was interrupted
        ]

"""Live truth in lockstep: the simulator sends truth and waits for the packets that are due up to then."""

from __future__ import annotations

from collections import deque

from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.feed.base import POLL_NS, Feed, PacketQueue
from lidar_emu.runtime.feed.live_truth_source import ReceivedTruth, TruthSource
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket
from lidar_emu.runtime.run_status import RunStatus
from lidar_emu.session import Session
from lidar_emu.trajectory.live_datagram import Answer, AnsweredPacket, Truth, Verdict, answers

_LINGER_NS = 200_000_000


class LockstepFeed(Feed):
    """Runs as fast as simulator and model can. Packets depend on truth alone: every shot lies between two truths.

    A repeated truth is answered again, so that a simulator whose answer was lost can continue.

    Args:
        status, session, packets, changes: see `Feed`.
        source: truth of the simulator.
    """

    def __init__(
        self,
        status: RunStatus,
        session: Session,
        packets: PacketQueue,
        changes: ChangeQueue,
        source: TruthSource,
    ) -> None:
        super().__init__(status, session, packets, changes)
        self._source = source
        self._flight = session.flight
        self._computed: deque[OutgoingPacket] = deque()
        self._last_answer: list[Answer] = []
        self._begun = False
        self._ended = False

    def run(self) -> None:
        while not self._ended and self._goes_on():
            self._port.wait(self._clock.now_ns() + POLL_NS, [self._source.fileno()])
            self._changes.receive(0 if self._source.newest is None else self._source.newest.time_ns)
            for received in self._source.receive():
                self._answer(received)
            self._packets.collect_reports()
        if self._begun:
            self._linger()
            self._source.notify()
            self._finish()

    def _goes_on(self) -> bool:
        return not self._status.stopped if self._begun else self._status.may_wait()

    def _linger(self) -> None:
        """Answer repeated truths for a while, since the last answer may have been lost."""
        ends_ns = self._clock.now_ns() + _LINGER_NS
        while self._clock.now_ns() < ends_ns and not self._status.stopped:
            self._port.wait(ends_ns, [self._source.fileno()])
            for received in self._source.receive():
                self._answer(received)

    def _answer(self, received: ReceivedTruth) -> None:
        truth = received.truth
        ends_by_repeat = received.verdict is Verdict.DUPLICATE and self._source.ended and not self._ended
        if truth is not None and (received.verdict is Verdict.ACCEPTED or ends_by_repeat):
            self._last_answer = self._advance(truth)
            self._source.answer(self._last_answer, received.sender)
        elif self._last_answer and received.verdict is Verdict.DUPLICATE:
            self._source.answer(self._last_answer, received.sender)
        else:
            time_ns = 0 if truth is None else truth.time_ns
            self._source.answer(answers(received.verdict, received.sequence, time_ns, ()), received.sender)

    def _advance(self, truth: Truth) -> list[Answer]:
        """Compute and send up to the time of this truth; return the answer to it."""
        if not self._begun:
            self._begun = True
            self._status.begin(self._clock.now_ns())
            self._source.begin(None)
            self._session.skip_to(-(-truth.time_ns // self._flight.period_ns))
        self._source.notify()
        self._compute(truth.time_ns)
        self._ended = self._source.ended or self._session.next_shot >= self._flight.shot_count
        packets = self._send(None if self._ended else truth.time_ns)
        return answers(Verdict.ACCEPTED, truth.sequence, truth.time_ns, packets)

    def _compute(self, time_ns: int) -> None:
        """Compute every shot that truth covers by now, whatever the grouping of truths."""
        session, flight = self._session, self._flight
        while session.next_shot < flight.shot_count and flight.seen_ns(session.next_shot) <= time_ns:
            while self._changes.first is not None:
                self._changes.apply_first(session, None)
            block = session.shoot(1)
            assert block is not None
            self._computed.extend(self._packets.announce(block))

    def _send(self, up_to_ns: int | None) -> list[AnsweredPacket]:
        """Send what is due by then, or everything; return it once the delivery status of each packet is known."""
        reports: list[DeliveryReport] = []
        pushed: list[OutgoingPacket] = []
        while self._computed and (up_to_ns is None or self._computed[0].due_ns <= up_to_ns):
            while not self._packets.push(self._computed[0]) and not self._status.stopped:
                reports += self._wait_for_reports()
            pushed.append(self._computed.popleft())
        while not (self._packets.empty or self._status.stopped):
            reports += self._wait_for_reports()
        return [
            AnsweredPacket(packet.shot, packet.due_ns, report.status, packet.payload)
            for packet, report in zip(
                pushed, reports, strict=False
            )  # fewer reports if the run was interrupted
        ]

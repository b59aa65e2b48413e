"""Live truth: in real time, each shot computed when truth covers it or can wait no longer; and in lockstep."""

from __future__ import annotations

from collections import deque
from contextlib import nullcontext
from dataclasses import dataclass
from typing import NamedTuple

from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.feed.base import Feed, PacketQueue
from lidar_emu.runtime.feed.live_truth_source import ReceivedTruth, TruthSource
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket
from lidar_emu.runtime.run_status import POLL_NS, RunStatus
from lidar_emu.scenario.trajectory import WhenStale
from lidar_emu.session import Session
from lidar_emu.trajectory.live_datagram import Answer, AnsweredPacket, Truth, Verdict, answers

_LONGEST_PAUSE = 63
"""Shots without a window, at most, after truth that came too late."""
_INERTIA = 8
"""Each arrival moves the prediction by 1 / `_INERTIA` of its deviation."""


class ArrivalWindow(NamedTuple):
    """Instants of the monotonic clock between which truth is expected."""

    opens_ns: int
    closes_ns: int

    def contains(self, now_ns: int) -> bool:
        """Whether the window is open."""
        return self.opens_ns <= now_ns < self.closes_ns


_NEVER = ArrivalWindow(0, 0)


class ArrivalPredictor:
    """Predicts when each shot's truth arrives: as long before its packet is due as for the last shots.

    Args:
        longest_ns: longest busy wait before and after the predicted arrival; 0: none.
    """

    def __init__(self, longest_ns: int) -> None:
        self._longest_ns = longest_ns
        self._after_due_ns: int | None = None
        self._around_ns = 0
        self._pause = self._paused = 0

    def window(self, due_ns: int) -> ArrivalWindow:
        """Window of the next shot's truth, whose packet is due at `due_ns`; empty before the first arrival, and for
        some shots after `missed`."""
        self._paused = max(0, self._paused - 1)
        if self._after_due_ns is None or self._paused:
            return _NEVER
        predicted_ns = due_ns + self._after_due_ns
        around_ns = min(self._around_ns, self._longest_ns)
        return ArrivalWindow(predicted_ns - around_ns, predicted_ns + around_ns)

    @property
    def has_time_to_warm_up(self) -> bool:
        """Whether a shot computed as the window opens is complete well before truth arrives."""
        return self._around_ns <= self._longest_ns

    def update(self, due_ns: int, arrived_ns: int, computing_ns: int, warm_up_ns: int) -> None:
        """Take into account when truth arrived, and how long its shot and the warm-up before took (0: there was none).

        The window has room for a warm-up, which takes longer than the shot after it, and for truth that comes early by
        as much as a shot takes.
        """
        after_due_ns = arrived_ns - due_ns
        if self._after_due_ns is None:
            self._after_due_ns = after_due_ns
        self._after_due_ns += (after_due_ns - self._after_due_ns) // _INERTIA
        self._around_ns = computing_ns + max(computing_ns, warm_up_ns)
        if not self._paused:
            self._pause //= 2

    def missed(self) -> None:
        """Take into account that truth came too late for its shot: the busy wait may have kept the simulator from its
        core. If that repeats, windows become rare."""
        if not self._paused:
            self._pause = min(2 * self._pause + 1, _LONGEST_PAUSE)
            self._paused = self._pause + 1


_IMMEDIATE_NS = 1_000_000
"""A packet that is due within this time is sent as soon as it is made."""


@dataclass(frozen=True)
class LiveTiming:
    """When shots with live truth are computed."""

    start_ns: int | None
    """Instant of the monotonic clock at scenario time 0; None: the first truth defines it, by its own time and its
    arrival."""
    lead_ns: int
    """A shot is computed at the latest this long before its packet is due, with or without truth."""
    late_after_ns: int
    """A shot whose packet is overdue by more than this is not computed."""
    busy_wait_ns: int
    """Longest busy wait before and after the expected arrival of truth; 0 on a single core."""


class LiveFeed(Feed):
    """Computes shots one by one.

    Args:
        when_stale: what happens to a shot whose truth is stale.
        machine: grants real-time priority.
    """

    def __init__(
        self,
        status: RunStatus,
        session: Session,
        packets: PacketQueue,
        changes: ChangeQueue,
        source: TruthSource,
        timing: LiveTiming,
        when_stale: WhenStale,
        machine: Machine,
    ) -> None:
        super().__init__(status, session, packets, changes)
        self._source = source
        self._flight = session.flight
        self._timing, self._start_ns = timing, timing.start_ns
        self._when_stale = when_stale
        self._machine = machine
        self._may_busy_wait = timing.busy_wait_ns > 0
        self._predictor = ArrivalPredictor(timing.busy_wait_ns)
        self._warm_up_ns = 0

    def run(self) -> None:
        if self._start_ns is not None:
            self._source.expect(self._start_ns)
        first = self._wait_for_first()
        if first is None:
            return
        self._begin(first)
        with self._machine.realtime_priority() if self._may_busy_wait else nullcontext():
            self._compute_shots()
        self._source.notify()
        self._finish()

    def _compute_shots(self) -> None:
        while (shot := self._session.next_shot) < self._flight.shot_count:
            self._wait_for_truth(shot)
            if self._status.stopped or (
                self._source.ended and not self._source.covers(self._flight.seen_ns(shot))
            ):
                break
            self._compute(shot)

    def _wait_for_first(self) -> ReceivedTruth | None:
        while self._status.may_wait():
            self._port.wait(self._clock.now_ns() + POLL_NS, [self._source.fileno()])
            self._changes.receive(0)
            # The first one defines the time by which the others are judged.
            for received in self._source.receive(1):
                if received.verdict is Verdict.ACCEPTED:
                    return received
        return None

    def _begin(self, first: ReceivedTruth) -> None:
        assert first.truth is not None
        if self._start_ns is None:
            self._start_ns = first.arrived_ns - first.truth.time_ns
        self._status.begin(self._start_ns)
        self._source.begin(self._start_ns)
        begun_ns = max(first.truth.time_ns, first.arrived_ns - self._start_ns, 0)
        self._session.skip_to(-(-begun_ns // self._flight.period_ns))
        if self._may_busy_wait:
            self._warm_up()

    def _warm_up(self) -> None:
        began_ns = self._clock.now_ns()
        if self._predictor.has_time_to_warm_up:
            self._session.warm_up()
        self._source.warm_up()
        self._warm_up_ns = self._clock.now_ns() - began_ns

    def _wait_for_truth(self, shot: int) -> None:
        source = self._source
        seen_ns = self._flight.seen_ns(shot)
        latest_ns = self._due_ns(shot) - self._timing.lead_ns
        window = self._predictor.window(self._due_ns(shot))
        is_warm = False
        # Pending work of earlier shots comes first, so that the shot is computed as soon as truth arrives.
        source.notify()
        self._packets.collect_reports()
        source.receive()
        while not (source.covers(seen_ns) or source.ended or self._status.stopped):
            now_ns = self._clock.now_ns()
            if now_ns >= latest_ns:
                break
            if not (busy_wait := window.contains(now_ns)):
                source.notify()
            elif not is_warm:
                self._warm_up()
                is_warm = True
            edges_ns = (edge_ns for edge_ns in window if edge_ns > now_ns)
            until_ns = min(latest_ns, now_ns + POLL_NS, *edges_ns)
            self._port.wait(until_ns, [source.fileno()], busy_wait)
            source.receive(1)  # to find no second one takes a tenth of a shot's computing time

    def _compute(self, shot: int) -> None:
        source = self._source
        self._apply_changes(shot)
        now_ns = self._clock.now_ns()
        too_late = now_ns > self._due_ns(shot) + self._timing.late_after_ns
        if too_late and not self._session.next_is_silent():
            self._session.skip_to(shot + 1)
            self._packets.missed(shot, self._flight.due_ns(shot), now_ns - self._start_ns_known())
            return
        fresh = source.is_fresh_at(self._flight.seen_ns(shot))
        if not fresh and self._when_stale == "abort":
            self._status.fail(f"truth is stale at shot {shot}, and trajectory.when_stale is abort")
            return
        if self._may_busy_wait and self._due_ns(shot) - now_ns < _IMMEDIATE_NS:
            self._port.wake_up()
        block = self._session.shoot(1, fired=fresh or self._when_stale == "coast")
        assert block is not None
        for packet in self._packets.announce(block):
            self._push(packet)
            source.used_for(packet, self._flight.seen_ns(shot))
        if source.covers(self._flight.seen_ns(shot)):
            computing_ns = self._clock.now_ns() - now_ns
            due_ns, arrived_ns = self._due_ns(shot), source.newest_arrived_ns
            self._predictor.update(due_ns, arrived_ns, computing_ns, self._warm_up_ns)
            self._warm_up_ns = 0
        else:
            self._predictor.missed()

    def _apply_changes(self, shot: int) -> None:
        start_ns = self._start_ns_known()
        begins_ns = start_ns + shot * self._flight.period_ns
        self._changes.receive(self._clock.now_ns() - start_ns, start_ns)
        while (change := self._changes.first) is not None and change.arrived_ns <= begins_ns:
            self._changes.apply_first(self._session, begins_ns)

    def _due_ns(self, shot: int) -> int:
        return self._start_ns_known() + self._flight.due_ns(shot)

    def _start_ns_known(self) -> int:
        assert self._start_ns is not None
        return self._start_ns


_LINGER_NS = 200_000_000


class LockstepFeed(Feed):
    """Runs as fast as simulator and model can. Packets depend on truth alone: every shot lies between two truths.

    A repeated truth is answered again, so that a simulator whose answer was lost can continue.
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
        while not self._ended and (not self._status.stopped if self._begun else self._status.may_wait()):
            self._port.wait(self._clock.now_ns() + POLL_NS, [self._source.fileno()])
            self._changes.receive(0 if self._source.newest is None else self._source.newest.time_ns)
            for received in self._source.receive():
                self._answer(received)
            self._packets.collect_reports()
        if self._begun:
            self._linger()
            self._source.notify()
            self._finish()

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
        # There are fewer reports if the run was interrupted.
        return [
            AnsweredPacket(packet.shot, packet.due_ns, report.status, packet.payload)
            for packet, report in zip(pushed, reports, strict=False)
        ]

"""Live truth at the pace of the clock: each shot is computed when truth covers it, or when it can wait no longer."""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING

from lidar_emu.runtime.feed.arrival_predictor import ArrivalPredictor
from lidar_emu.runtime.feed.base import POLL_NS, Desk
from lidar_emu.runtime.feed.truth_source import Arrival, TruthSource
from lidar_emu.runtime.realtime import prompt
from lidar_emu.scenario.trajectory import Live
from lidar_emu.trajectory.live_datagram import Verdict

if TYPE_CHECKING:
    from lidar_emu.flight.flight import Flight

_AT_ONCE_NS = 1_000_000
"""A packet that is due within this time is sent as soon as it is made."""


class LiveFeed:
    """Shots one by one.

    Args:
        start_ns: instant of the monotonic clock at scenario time 0; None: the first truth says, by its own time, as it
            arrives.
        late_after_ns: a shot that is later than this before it is computed is not computed.
        busy_wait_share: share of the shot period that may be spent in a busy wait around the expected arrival of truth;
            0 where simulator, model and port have less than a core each.
    """

    def __init__(
        self,
        desk: Desk,
        source: TruthSource,
        flight: Flight,
        part: Live,
        start_ns: int | None,
        late_after_ns: int,
        busy_wait_share: float,
    ) -> None:
        self._desk = desk
        self._source = source
        self._flight = flight
        self._part = part
        self._start_ns = start_ns
        self._late_after_ns = late_after_ns
        self._may_wake = busy_wait_share > 0
        self._anticipation = ArrivalPredictor(round(busy_wait_share * flight.period_ns))

    def fly(self) -> None:
        """See `Feed`."""
        desk = self._desk
        if self._start_ns is not None:
            self._source.expect(self._start_ns)
        first = self._await_first()
        if first is None:
            return
        self._begin(first)
        with prompt() if self._may_wake else nullcontext():
            self._fly()
        self._source.tell()
        desk.finish()

    def _fly(self) -> None:
        desk = self._desk
        while desk.session.next_shot < self._flight.shot_count:
            shot = desk.session.next_shot
            self._await(shot)
            if desk.interrupted() or (
                self._source.ended and not self._source.covers(self._flight.seen_ns(shot))
            ):
                break
            self._fire(shot)

    def _await_first(self) -> Arrival | None:
        while not self._desk.interrupted():
            self._desk.outbox.wait(self._desk.clock.now_ns() + POLL_NS, [self._source.fileno()])
            self._desk.hear(0)
            accepted = [arrival for arrival in self._source.receive() if arrival.verdict is Verdict.ACCEPTED]
            if accepted:
                return accepted[0]
        return None

    def _begin(self, first: Arrival) -> None:
        """The first shot is the one that begins with the first truth, or after it."""
        assert first.truth is not None
        if self._start_ns is None:
            self._start_ns = first.arrived_ns - first.truth.time_ns
        self._desk.begin(self._start_ns)
        self._source.begin(self._start_ns)
        begun_ns = max(first.truth.time_ns, first.arrived_ns - self._start_ns, 0)
        self._desk.session.pass_over(-(-begun_ns // self._flight.period_ns))

    def _await(self, shot: int) -> None:
        """Until truth covers the shot, the flight has ended, or the packet cannot wait."""
        desk, source = self._desk, self._source
        seen_ns = self._flight.seen_ns(shot)
        latest_ns = self._due_ns(shot) - round(self._part.lead_s * 1e9)
        window = self._anticipation.window(self._due_ns(shot))
        rehearsed = not self._anticipation.has_time_to_rehearse
        # What is left of earlier shots is done first: once truth is there, nothing is but the shot.
        source.tell()
        desk.outbox.settle()
        source.receive()
        while not (source.covers(seen_ns) or source.ended or desk.interrupted()):
            now_ns = desk.clock.now_ns()
            if now_ns >= latest_ns:
                break
            if not (awake := window.holds(now_ns)):
                source.tell()
            elif not rehearsed:
                desk.session.rehearse()
                source.rehearse()
                rehearsed = True
            edges_ns = (edge_ns for edge_ns in window if edge_ns > now_ns)
            until_ns = min(latest_ns, now_ns + POLL_NS, *edges_ns)
            desk.outbox.wait(until_ns, [source.fileno()], awake)
            source.receive_one()

    def _fire(self, shot: int) -> None:
        desk, source = self._desk, self._source
        self._follow_changes(shot)
        now_ns = desk.clock.now_ns()
        too_late = now_ns > self._due_ns(shot) + self._late_after_ns
        if too_late and not desk.session.next_is_silent():
            desk.session.pass_over(shot + 1)
            desk.outbox.missed(shot, self._flight.due_ns(shot), now_ns - self._start_ns_known())
            return
        fresh = source.is_fresh_at(self._flight.seen_ns(shot))
        if not fresh and self._part.when_stale == "abort":
            desk.fail(f"truth is stale at shot {shot}, and trajectory.when_stale is abort")
            return
        if self._may_wake and self._due_ns(shot) - now_ns < _AT_ONCE_NS:
            desk.outbox.alert()
        block = desk.session.shoot(1, fired=fresh or self._part.when_stale == "coast")
        assert block is not None
        for packet in desk.outbox.announce(block):
            desk.push(packet)
            source.used_for(packet, self._flight.seen_ns(shot))
        if source.covers(self._flight.seen_ns(shot)):
            took_ns = desk.clock.now_ns() - now_ns
            self._anticipation.learn(self._due_ns(shot), source.newest_arrived_ns, took_ns)

    def _follow_changes(self, shot: int) -> None:
        """Those that came before the shot began."""
        desk = self._desk
        begins_ns = self._start_ns_known() + shot * self._flight.period_ns
        desk.hear(desk.clock.now_ns() - self._start_ns_known(), self._start_ns_known())
        while (change := desk.changes.first) is not None and change.arrived_ns <= begins_ns:
            desk.follow(begins_ns)

    def _due_ns(self, shot: int) -> int:
        return self._start_ns_known() + self._flight.due_ns(shot)

    def _start_ns_known(self) -> int:
        assert self._start_ns is not None
        return self._start_ns

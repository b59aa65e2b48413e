"""A prescribed flight: shots computed ahead of time, as far as the ring holds them, and again after a command."""

from __future__ import annotations

from collections import deque

from lidar_emu.runtime.change_queue import Change
from lidar_emu.runtime.feed.base import Desk
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.runtime.port.packets import Outgoing
from lidar_emu.session import Block

_LEAD_NS = 100_000_000
_HEAD_START_NS = 250_000_000
_REACTION_NS = 3_000_000
"""What it takes to compute the first shot after a command, and to tell the port: no packet that is due sooner is
changed."""


class AheadFeed:
    """Computes block after block.

    Args:
        first: the block that has been computed already.
        block_shots: the longest further one.
        start_ns: instant of the monotonic clock at scenario time 0; None: once some shots are computed.
        period_ns: from shot to shot.
    """

    def __init__(
        self, desk: Desk, first: Block, block_shots: int, start_ns: int | None, period_ns: int, pace: Pace
    ) -> None:
        self._desk = desk
        self._first = first
        self._longest = self._next_length = block_shots
        self._start_ns = 0 if start_ns is None else start_ns
        self._starts_soon = start_ns is None
        self._period_ns = period_ns
        self._pace = pace
        self._latency_ns = int(first.measurement.due_ns[0])
        self._waiting: deque[Outgoing] = deque()
        self._until: int | None = None
        """The shot that is to be the first to follow what was heard, if it is still to come."""
        self._last_followed = 0

    def fly(self) -> None:
        """See `Feed`."""
        desk = self._desk
        self._waiting.extend(desk.outbox.announce(self._first))
        if self._starts_soon:
            self._get_ahead()
            self._start_ns = desk.clock.now_ns() + _LEAD_NS
        desk.begin(self._start_ns)
        while not desk.interrupted() and self._go_on():
            desk.outbox.settle()
        desk.finish()

    def _get_ahead(self) -> None:
        """So that the run does not begin with a model that is just about as fast as its shots are due."""
        if self._pace is not Pace.WALL:
            return
        until_ns, self._next_length = self._desk.clock.now_ns() + _HEAD_START_NS, 1
        while not self._desk.interrupted():
            while self._waiting and self._desk.outbox.push(self._waiting[0]):
                self._waiting.popleft()
            if (
                self._waiting
                or self._desk.clock.now_ns() >= until_ns
                or (block := self._next_block()) is None
            ):
                return
            self._waiting.extend(self._desk.outbox.announce(block))

    def _go_on(self) -> bool:
        """Do the next thing; False if there is nothing left to do."""
        desk = self._desk
        if self._pace is Pace.WALL:
            desk.hear(desk.clock.now_ns() - self._start_ns, self._start_ns)
        else:
            desk.hear(self._next_to_push() * self._period_ns)
        self._follow_changes()
        if self._waiting:
            if desk.outbox.push(self._waiting[0]):
                self._waiting.popleft()
            else:
                desk.rest()
        elif (block := self._next_block()) is not None:
            self._waiting.extend(desk.outbox.announce(block))
        elif desk.outbox.empty:
            return False
        else:
            desk.rest()
        return True

    def _next_block(self) -> Block | None:
        """Short at first after a change, so that its first shot is soon there."""
        session = self._desk.session
        length = self._next_length
        self._next_length = min(2 * length, self._longest)
        if self._until is not None:
            length = min(length, self._until - session.next_shot)
        return session.shoot(length)

    def _follow_changes(self) -> None:
        """Compute anew the shots that were computed before something was heard that they are to follow."""
        desk, session = self._desk, self._desk.session
        while (change := desk.changes.first) is not None:
            shot = self._until = self._first_to_follow(change)
            if shot > session.next_shot or (shot == session.next_shot and session.is_over):
                return
            if shot < session.next_shot:
                desk.outbox.supersede(shot)
                session.rewind(shot)
                self._waiting = deque(packet for packet in self._waiting if packet.shot < shot)
            desk.follow(self._begins_ns(shot))
            self._last_followed, self._next_length = shot, 1
        self._until = None

    def _first_to_follow(self, change: Change) -> int:
        """The first shot to begin after the command, and late enough that its packet can still be made.

        None before the one that followed the change before: going back beyond that would undo it.
        """
        if self._pace is not Pace.WALL:
            return self._next_to_push()
        ready_ns = self._desk.clock.now_ns() + _REACTION_NS - self._latency_ns
        begins_ns = max(change.arrived_ns, ready_ns) - self._start_ns
        return max(self._last_followed, -(-begins_ns // self._period_ns))

    def _next_to_push(self) -> int:
        return self._waiting[0].shot if self._waiting else self._desk.session.next_shot

    def _begins_ns(self, shot: int) -> int | None:
        return self._start_ns + shot * self._period_ns if self._pace is Pace.WALL else None

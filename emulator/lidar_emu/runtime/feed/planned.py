"""A planned flight: shots are computed ahead of time, as far as the ring has room, and again after a command."""

from __future__ import annotations

from collections import deque
from contextlib import AbstractContextManager, nullcontext

from lidar_emu.runtime.change_queue import Change, ChangeQueue
from lidar_emu.runtime.feed.base import Feed, PacketQueue
from lidar_emu.runtime.port.packets import OutgoingPacket, Pace
from lidar_emu.runtime.run_status import RunStatus
from lidar_emu.session import Block, Session
from lidar_emu.shots.model import Model
from lidar_emu.trajectory.live_datagram import Truth
from lidar_emu.wire import Encoder

_LEAD_NS = 100_000_000
_HEAD_START_NS = 250_000_000
_REACTION_NS = 3_000_000
"""Time to compute the first shot after a command and to inform the port: no packet that is due sooner is changed."""

_STILL = (0.0, 0.0, 0.0)
_FACING_DOWN = (0.0, 0.5**0.5, 0.5**0.5, 0.0)
_HOVER = Truth(0, 0, (0.0, 0.0, 1000.0), _STILL, _STILL, _FACING_DOWN, _STILL)


class PlannedShots:
    """The shots of a session in blocks, the first of which is computed before the run.

    Args:
        session: computes the shots, with this model and encoder.
        block_shots: shots in the longest block.
        known: whether the first shots are known before the run.
    """

    def __init__(
        self, session: Session, model: Model, encoder: Encoder, block_shots: int, known: bool
    ) -> None:
        self.session, self.block_shots, self._known = session, block_shots, known
        if not (known and session.device.measures):
            self.sample = warm_up(model, encoder)
            """The first block of the flight or, if that is not known, a shot like it."""
        if known:
            self.sample = self._next()

    def first(self) -> Block:
        """The first block of the flight."""
        return self.sample if self._known else self._next()

    def _next(self) -> Block:
        block = self.session.shoot(self.block_shots)
        assert block is not None
        return block


def warm_up(model: Model, encoder: Encoder) -> Block:
    """Compute shot 0, to compile the flight's kernels and to obtain the length of packets; return it.

    With live truth the shot is computed one kilometre above the site's origin, and has no effect on the flight.
    """
    hovering: AbstractContextManager[None] = nullcontext()
    if model.flight is not None and model.flight.is_live:
        from lidar_emu.trajectory.live import LiveTrajectory

        assert isinstance(model.flight.trajectory, LiveTrajectory)
        hovering = model.flight.trajectory.pretending(_HOVER)
    with hovering:
        block = Session(model, encoder).shoot(1)
    assert block is not None
    return block


class PlannedFeed(Feed):
    """Computes block after block.

    Args:
        status, session, packets, changes: see `Feed`.
        first: the block that has been computed already.
        block_shots: shots in the longest further block.
        start_ns: instant of the monotonic clock at scenario time 0; None: once some shots are computed.
    """

    def __init__(
        self,
        status: RunStatus,
        session: Session,
        packets: PacketQueue,
        changes: ChangeQueue,
        first: Block,
        block_shots: int,
        start_ns: int | None,
        pace: Pace,
    ) -> None:
        super().__init__(status, session, packets, changes)
        self._first = first
        self._longest = self._next_length = block_shots
        self._start_ns = 0 if start_ns is None else start_ns
        self._starts_soon = start_ns is None
        self._period_ns = session.period_ns
        self._pace = pace
        self._latency_ns = int(first.measurement.due_ns[0])
        self._waiting: deque[OutgoingPacket] = deque()
        self._until: int | None = None
        """First shot that the oldest change affects, if it is still to come."""
        self._last_changed = 0

    def run(self) -> None:
        self._waiting.extend(self._packets.announce(self._first))
        if self._starts_soon:
            self._get_ahead()
            self._start_ns = self._clock.now_ns() + _LEAD_NS
        self._status.begin(self._start_ns)
        while not self._status.stopped and self._step():
            self._packets.collect_reports()
        self._finish()

    def _get_ahead(self) -> None:
        """Fill the ring before the start, so that a model that is barely fast enough has a reserve."""
        if self._pace is not Pace.WALL:
            return
        until_ns, self._next_length = self._clock.now_ns() + _HEAD_START_NS, 1
        while not self._status.stopped:
            while self._waiting and self._packets.push(self._waiting[0]):
                self._waiting.popleft()
            if self._waiting or self._clock.now_ns() >= until_ns or (block := self._next_block()) is None:
                return
            self._waiting.extend(self._packets.announce(block))

    def _step(self) -> bool:
        """Push a packet, compute a block, or wait; False if nothing is left to do."""
        if self._pace is Pace.WALL:
            self._changes.receive(self._clock.now_ns() - self._start_ns, self._start_ns)
        else:
            self._changes.receive(self._next_to_push() * self._period_ns)
        self._apply_changes()
        if self._waiting:
            if self._packets.push(self._waiting[0]):
                self._waiting.popleft()
            else:
                self._wait_for_reports()
        elif (block := self._next_block()) is not None:
            self._waiting.extend(self._packets.announce(block))
        elif self._packets.empty:
            return False
        else:
            self._wait_for_reports()
        return True

    def _next_block(self) -> Block | None:
        """The next block: short after a change, so that its first shot is ready soon."""
        length = self._next_length
        self._next_length = min(2 * length, self._longest)
        if self._until is not None:
            length = min(length, self._until - self._session.next_shot)
        return self._session.shoot(length)

    def _apply_changes(self) -> None:
        """Apply changes, and go back to the first shot that each affects if it was computed already."""
        session = self._session
        while (change := self._changes.first) is not None:
            shot = self._until = self._first_affected(change)
            if shot > session.next_shot or (shot == session.next_shot and session.is_over):
                return
            if shot < session.next_shot:
                self._packets.supersede(shot)
                session.rewind(shot)
                self._waiting = deque(packet for packet in self._waiting if packet.shot < shot)
            begins_ns = self._start_ns + shot * self._period_ns if self._pace is Pace.WALL else None
            self._changes.apply_first(session, begins_ns)
            self._last_changed, self._next_length = shot, 1
        self._until = None

    def _first_affected(self, change: Change) -> int:
        """The first shot that begins after the change, and late enough that its packet can still be made.

        Never one before the first shot of the previous change: going back further would undo that change.
        """
        if self._pace is not Pace.WALL:
            return self._next_to_push()
        ready_ns = self._clock.now_ns() + _REACTION_NS - self._latency_ns
        begins_ns = max(change.arrived_ns, ready_ns) - self._start_ns
        return max(self._last_changed, -(-begins_ns // self._period_ns))

    def _next_to_push(self) -> int:
        return self._waiting[0].shot if self._waiting else self._session.next_shot

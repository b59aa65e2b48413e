"""When shots are computed: feeds under a clock that only waiting moves, hours in a moment."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from lidar_emu.runtime.command_post import Change
from lidar_emu.runtime.feed import Desk
from lidar_emu.runtime.feed_ahead import AheadFeed
from lidar_emu.runtime.feed_live import LiveFeed
from lidar_emu.runtime.pacing import Pace
from lidar_emu.runtime.packets import Outgoing
from lidar_emu.runtime.truth_source import TruthSource
from lidar_emu.scenario.trajectory import Live
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.live_datagram import Truth

MS = 1_000_000
START_NS = 5_000 * MS
PERIOD_NS, SEEN_NS, DUE_NS = 50 * MS, MS // 2, 3 * MS
STILL = (0.0, 0.0, 0.0)


class World:
    """Clock, port, session and flight: what was computed, when, and by which pattern."""

    def __init__(self, shots: int) -> None:
        self.now = START_NS - 1_000 * MS
        self.computed: list[tuple[int, int, bool]] = []
        self.never: list[int] = []
        self.sent: list[tuple[int, int]] = []
        self.stalls: dict[int, int] = {}
        self.news: deque[int] = deque()
        self.room = 40
        self._pattern = 0
        self._patterns: dict[int, int] = {}
        self._ring: deque[tuple[int, int]] = deque()
        self.next_shot = 0
        self.shot_count = shots
        self.period_ns = PERIOD_NS
        self.through = True

    # the clock
    def now_ns(self) -> int:
        return self.now

    # the flight
    def due_ns(self, shot: int) -> int:
        return shot * PERIOD_NS + DUE_NS

    def seen_ns(self, shot: int) -> int:
        return shot * PERIOD_NS + SEEN_NS

    # the session
    def shoot(self, most: int, fired: bool = True) -> Any:
        count = min(most, self.shot_count - self.next_shot)
        if count <= 0:
            return None
        shots = range(self.next_shot, self.next_shot + count)
        self.next_shot += count
        self.computed += [(shot, self.now, fired) for shot in shots]
        self.now += sum(self.stalls.pop(shot, 0) for shot in shots)
        return [(shot, self._pattern) for shot in shots]

    def pass_over(self, shot: int) -> None:
        self.next_shot = max(shot, self.next_shot)

    def rewind(self, shot: int) -> None:
        self.next_shot = shot

    def use_pattern(self, pattern: int) -> None:
        self._pattern = pattern

    # the outbox
    def announce(self, block: Any) -> list[Outgoing]:
        self._patterns.update(block)
        return [Outgoing(shot, self.due_ns(shot), b"") for shot, _ in block]

    def push(self, packet: Outgoing) -> bool:
        if len(self._ring) >= self.room:
            return False
        self._ring.append((packet.shot, self._patterns[packet.shot]))
        return True

    def supersede(self, from_shot: int) -> None:
        assert all(START_NS + self.due_ns(shot) > self.now for shot, _ in self._ring if shot >= from_shot)
        self._ring = deque(entry for entry in self._ring if entry[0] < from_shot)

    def settle(self) -> list[Any]:
        while self._ring and START_NS + self.due_ns(self._ring[0][0]) <= self.now:
            self.sent.append(self._ring.popleft())
        return []

    def missed(self, shot: int, due_ns: int, now_ns: int) -> None:
        assert now_ns > due_ns
        self.never.append(shot)

    def wait(self, until_ns: int, readable: Sequence[int] = ()) -> None:
        self.now = max(self.now, min(until_ns, self.news[0]) if readable and self.news else until_ns)

    def arrivals(self) -> list[Any]:
        return []

    def last_packet_pushed(self) -> None:
        self.now = max(self.now, START_NS + self.due_ns(self.shot_count))
        self.settle()

    @property
    def empty(self) -> bool:
        return not self._ring


class Socket:
    """Truths that arrive at instants of the world's clock."""

    def __init__(self, world: World, truths: list[tuple[int, Truth]]) -> None:
        self._world, self._truths = world, deque(truths)
        world.news = deque(arrives_ns for arrives_ns, _ in truths)

    def fileno(self) -> int:
        return 3

    def receive(self) -> list[tuple[bytes, int, str]]:
        arrived = []
        while self._truths and self._truths[0][0] <= self._world.now:
            arrives_ns, truth = self._truths.popleft()
            self._world.news.popleft()
            arrived.append((truth.to_bytes(), arrives_ns, "simulator"))
        return arrived


def truth(k: int, period_ns: int, last: bool = False) -> Truth:
    return Truth(
        k, k * period_ns, (0, 0, 900 - k * period_ns * 1e-9), (0, 0, -1), STILL, (1, 0, 0, 0), STILL, last
    )


def to_pattern(number: int, arrived_ns: int) -> Change:
    return Change(lambda session: session.use_pattern(number), arrived_ns)


def desk(world: World, changes: list[tuple[int, Change]] | None = None) -> Any:
    """With commands that can be heard from given instants on."""
    waiting = changes if changes is not None else []

    class Heard(Desk):
        def next_change(self) -> Change | None:
            return waiting.pop(0)[1] if waiting and waiting[0][0] <= world.now else None

    failed: list[str] = []
    any_world: Any = world
    return Heard(
        any_world, any_world, any_world, lambda: bool(failed), failed.append, lambda _start_ns: None, None
    )


def fly_live(world: World, truths: list[tuple[int, Truth]], **part: Any) -> TruthSource:
    socket: Any = Socket(world, truths)
    source = TruthSource(socket, LiveTrajectory(10.0), 100 * MS, [])
    flight: Any = world
    live = Live(kind="live", **part)
    LiveFeed(desk(world), source, flight, live, START_NS, PERIOD_NS).fly()
    return source


def test_an_hour_of_truth_every_20_ms() -> None:
    """A shot is computed when the first truth that covers it arrives, and never waits for the next one."""
    shots = 72_000
    world = World(shots)
    truths = [(START_NS + k * 20 * MS, truth(k, 20 * MS)) for k in range(1, 3600 * 50 + 2)]
    fly_live(world, [(START_NS - 10 * MS, truth(0, 20 * MS)), *truths])
    assert [shot for shot, _, _ in world.computed] == list(range(shots))
    for shot, at_ns, fired in world.computed:
        covers_ns = -(-world.seen_ns(shot) // (20 * MS)) * 20 * MS
        deadline_ns = world.due_ns(shot) - MS
        assert at_ns - START_NS == min(covers_ns, deadline_ns)
        assert fired
    assert world.never == []


def test_without_truth_a_shot_waits_until_it_can_wait_no_longer() -> None:
    world = World(20)
    source = fly_live(world, [(START_NS - MS, truth(0, MS))], lead_s=0.002, when_stale="invalid")
    assert [at_ns for _, at_ns, _ in world.computed] == [
        START_NS + world.due_ns(k) - 2 * MS for k in range(20)
    ]
    assert [fired for _, _, fired in world.computed] == [True, True] + [False] * 18
    assert source.to_json()["stale_shots"] == 18


def test_after_a_stall_no_burst_follows() -> None:
    world = World(40)
    world.stalls = {10: 420 * MS}
    truths = [(START_NS + k * 10 * MS, truth(k, 10 * MS)) for k in range(1, 300)]
    fly_live(world, [(START_NS - MS, truth(0, 10 * MS)), *truths])
    assert world.never == list(range(11, 18))
    after = [(shot, at_ns) for shot, at_ns, _ in world.computed if shot > 10]
    assert [shot for shot, _ in after] == list(range(18, 40))
    assert all(at_ns - START_NS <= world.due_ns(shot) + PERIOD_NS for shot, at_ns in after)


def test_the_flight_ends_with_the_last_truth() -> None:
    world = World(1000)
    truths = [(START_NS + k * 10 * MS, truth(k, 10 * MS, last=k == 52)) for k in range(1, 53)]
    fly_live(world, [(START_NS - MS, truth(0, 10 * MS)), *truths])
    assert [shot for shot, _, _ in world.computed] == list(range(11))


def block_of(world: World, shots: int) -> Any:
    class Block(list):  # type: ignore[type-arg]
        measurement = SimpleNamespace(due_ns=[DUE_NS])

    return Block(world.shoot(shots))


@pytest.mark.parametrize("commanded_ms", [0, 1, 49, 51, 1234, 30_000])
def test_a_command_is_followed_from_the_next_shot_that_can_be_made(commanded_ms: int) -> None:
    world = World(900)
    arrived_ns = START_NS + commanded_ms * MS
    first = block_of(world, 30)
    feed = AheadFeed(
        desk(world, [(arrived_ns, to_pattern(1, arrived_ns))]), first, 30, START_NS, PERIOD_NS, Pace.WALL
    )
    feed.fly()
    assert [shot for shot, _ in world.sent] == list(range(900)), "every shot once, in order"
    patterns = [pattern for _, pattern in world.sent]
    follows = patterns.index(1)
    assert patterns == [0] * follows + [1] * (900 - follows)
    # The feed rests up to 20 ms, and keeps 3 ms to make the packet.
    begins_ns = START_NS + follows * PERIOD_NS
    assert arrived_ns <= begins_ns <= arrived_ns + PERIOD_NS + 23 * MS


@pytest.mark.parametrize(("room", "computed"), [(100, 1 + 1 + 2 + 4 + 8 + 16), (10, 1 + 1 + 2 + 4 + 8)])
def test_without_a_given_start_the_run_begins_once_shots_are_there(room: int, computed: int) -> None:
    """A model that needs 10 ms for a shot, in blocks of 1, 2, 4, ...: until 250 ms are over, or the ring is full."""
    world = World(200)
    world.room = room
    world.stalls = dict.fromkeys(range(1, 200), 10 * MS)
    begun: list[tuple[int, int]] = []
    at_work = desk(world)._replace(begin=lambda start_ns: begun.append((start_ns, len(world.computed))))
    first = block_of(world, 1)
    asked_ns = world.now
    AheadFeed(at_work, first, 30, None, PERIOD_NS, Pace.WALL).fly()
    assert begun == [(asked_ns + 10 * MS * (computed - 1) + 100 * MS, computed)]
    assert [shot for shot, _ in world.sent] == list(range(200))


def test_two_commands_at_once_and_one_at_the_end() -> None:
    world = World(200)
    instants = [START_NS + t * MS for t in (1000, 1001, 9990)]
    changes = [(at_ns, to_pattern(k + 1, at_ns)) for k, at_ns in enumerate(instants)]
    first = block_of(world, 30)
    AheadFeed(desk(world, changes), first, 30, START_NS, PERIOD_NS, Pace.WALL).fly()
    assert [shot for shot, _ in world.sent] == list(range(200))
    patterns = [pattern for _, pattern in world.sent]
    assert sorted(patterns) == patterns
    assert patterns[-2] == 2
    assert patterns[15:20] == [0] * 5 or patterns[15:20] == [0] * 4 + [1]

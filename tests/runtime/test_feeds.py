"""When shots are computed: feeds under a clock that only waiting moves, hours in a moment."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from lidar_emu.runtime.change_queue import Change, ChangeQueue
from lidar_emu.runtime.feed.live import ArrivalPredictor, LiveFeed, LiveTiming
from lidar_emu.runtime.feed.live_truth_source import TruthSource
from lidar_emu.runtime.feed.planned import PlannedFeed
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.port.packets import OutgoingPacket, Pace
from lidar_emu.scenario.trajectory import Live
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.live_datagram import Truth

MS = 1_000_000
START_NS = 5_000 * MS
PERIOD_NS, SEEN_NS, DUE_NS = 50 * MS, MS // 2, 3 * MS
STILL = (0.0, 0.0, 0.0)


class World:
    """Clock, port, session, flight, queue and control: what was computed, when, and by which pattern."""

    def __init__(self, shots: int) -> None:
        self.now = START_NS - 1_000 * MS
        self.computed: list[tuple[int, int, bool]] = []
        self.never: list[int] = []
        self.sent: list[tuple[int, int]] = []
        self.silent: set[int] = set()
        self.stalls: dict[int, int] = {}
        self.news: deque[int] = deque()
        self.room = 40
        self.shot_takes_ns = self.warm_up_takes_ns = 0
        self.warmed_up: list[tuple[int, int]] = []
        self.wake_ups: list[int] = []
        self.busy: list[tuple[int, int]] = []
        self._pattern = 0
        self._patterns: dict[int, int] = {}
        self._ring: deque[tuple[int, int]] = deque()
        self.next_shot = 0
        self.shot_count = shots
        self.period_ns = PERIOD_NS
        self.finished = True
        self.begun: list[tuple[int, int]] = []
        self.error: str | None = None
        self.clock = self.port = self.flight = self

    # the control
    @property
    def stopped(self) -> bool:
        return self.error is not None

    def may_wait(self) -> bool:
        return not self.stopped

    def begin(self, start_ns: int) -> None:
        self.begun.append((start_ns, len(self.computed)))

    def fail(self, error: str) -> None:
        self.error = error

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
        self.now += sum(self.stalls.pop(shot, self.shot_takes_ns) for shot in shots)
        return [(shot, self._pattern) for shot in shots]

    def next_is_silent(self) -> bool:
        return self.next_shot in self.silent

    def warm_up(self) -> None:
        self.warmed_up.append((self.next_shot, self.now))
        self.now += self.warm_up_takes_ns

    def skip_to(self, shot: int) -> None:
        self.next_shot = max(shot, self.next_shot)

    def rewind(self, shot: int) -> None:
        self.next_shot = shot

    @property
    def is_over(self) -> bool:
        return self.next_shot >= self.shot_count

    def use_pattern(self, pattern: int) -> None:
        self._pattern = pattern

    # the port and its queue
    def announce(self, block: Any) -> list[OutgoingPacket]:
        self._patterns.update(block)
        return [OutgoingPacket(shot, self.due_ns(shot), b"") for shot, _ in block]

    def push(self, packet: OutgoingPacket) -> bool:
        if len(self._ring) >= self.room:
            return False
        self._ring.append((packet.shot, self._patterns[packet.shot]))
        return True

    def supersede(self, from_shot: int) -> None:
        assert all(START_NS + self.due_ns(shot) > self.now for shot, _ in self._ring if shot >= from_shot)
        self._ring = deque(entry for entry in self._ring if entry[0] < from_shot)

    def collect_reports(self) -> list[Any]:
        while self._ring and START_NS + self.due_ns(self._ring[0][0]) <= self.now:
            self.sent.append(self._ring.popleft())
        return []

    def missed(self, shot: int, due_ns: int, now_ns: int) -> None:
        assert now_ns > due_ns
        self.never.append(shot)

    def wake_up(self) -> None:
        self.wake_ups.append(self.now)

    def wait(self, until_ns: int, readable: Sequence[int] = (), busy_wait: bool = False) -> None:
        began_ns = self.now
        self.now = max(self.now, min(until_ns, self.news[0]) if readable and self.news else until_ns)
        if busy_wait:
            self.busy.append((began_ns, self.now))

    def end_packets(self) -> None:
        self.now = max(self.now, START_NS + self.due_ns(self.shot_count))
        self.collect_reports()

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

    def receive(self, most: int = 64) -> list[tuple[bytes, int, str]]:
        arrived: list[tuple[bytes, int, str]] = []
        while len(arrived) < most and self._truths and self._truths[0][0] <= self._world.now:
            arrives_ns, truth = self._truths.popleft()
            self._world.news.popleft()
            arrived.append((truth.to_bytes(), arrives_ns, "simulator"))
        return arrived


def truth(k: int, period_ns: int, last: bool = False) -> Truth:
    return Truth(
        k, k * period_ns, (0, 0, 900 - k * period_ns * 1e-9), (0, 0, -1), STILL, (1, 0, 0, 0), STILL, last
    )


def to_pattern(number: int, arrived_ns: int, followed: list[Any] | None = None) -> Change:
    def applied(shot: int | None, begins_ns: int | None) -> None:
        if followed is not None:
            followed.append((number, shot, begins_ns))

    any_session: Any = lambda session: session.use_pattern(number)  # noqa: E731
    return Change(any_session, arrived_ns, applied)


class Arriving(ChangeQueue):
    """Changes that arrive at given instants."""

    def __init__(self, world: World, changes: list[tuple[int, Change]]) -> None:
        port: Any = world
        super().__init__(port, None, None)
        self._world, self._arriving = world, changes

    def receive(self, time_ns: int, start_ns: int | None = None) -> None:  # noqa: ARG002
        while self._arriving and self._arriving[0][0] <= self._world.now:
            self._pending.append(self._arriving.pop(0)[1])


def shared(world: World, changes: list[tuple[int, Change]] | None = None) -> tuple[Any, Any, Any, Arriving]:
    """The first arguments of a feed, with changes that arrive at given instants."""
    return world, world, world, Arriving(world, list(changes or ()))


def timing(live: Live, busy_wait_share: float = 0.1) -> LiveTiming:
    return LiveTiming(START_NS, round(live.lead_s * 1e9), PERIOD_NS, round(busy_wait_share * PERIOD_NS))


def fly_live(
    world: World, truths: list[tuple[int, Truth]], busy_wait_share: float = 0.1, **part: Any
) -> TruthSource:
    socket: Any = Socket(world, truths)
    source = TruthSource(socket, LiveTrajectory(100 * MS), 100 * MS, [], [])
    live = Live(kind="live", **part)
    LiveFeed(*shared(world), source, timing(live, busy_wait_share), live.when_stale, Machine()).run()
    return source


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


def test_truth_is_expected_in_a_busy_wait_and_after_a_warm_up() -> None:
    """It comes 1.5 ms before each packet is due, once 0.2 ms sooner and once not at all."""
    world = World(60)
    world.shot_takes_ns, world.warm_up_takes_ns = MS // 4, MS // 2
    usual_ns = [START_NS + world.due_ns(k) - 3 * MS // 2 for k in range(60)]
    arrives_ns = dict(enumerate(usual_ns)) | {40: usual_ns[40] - MS // 5}
    del arrives_ns[50]
    truths = [(at_ns, truth(k, 1)._replace(time_ns=world.seen_ns(k))) for k, at_ns in arrives_ns.items()]
    fly_live(world, [(START_NS - MS, truth(0, MS)), *truths], lead_s=0)
    assert [at_ns for shot, at_ns, _ in world.computed if shot != 50] == list(arrives_ns.values())
    # The first shot as the flight begins, each other one as long before truth as warm-up and shot take.
    opened_ns = dict(world.warmed_up)
    assert list(opened_ns) == [shot for shot in range(60) if shot != 51], "none after truth that did not come"
    assert opened_ns.pop(0) == START_NS - MS
    around_ns = 3 * MS // 4
    assert all(at_ns == usual_ns[shot] - around_ns for shot, at_ns in opened_ns.items() if shot <= 40)
    assert all(abs(at_ns - usual_ns[shot] + around_ns) <= MS // 20 for shot, at_ns in opened_ns.items())
    # As long after it, where truth does not come: the rest is slept through.
    ended_ns = [end_ns for _, end_ns in world.busy]
    assert set(arrives_ns.values()) - {arrives_ns[0], arrives_ns[51]} <= set(ended_ns)
    (given_up_ns,) = set(ended_ns) - set(arrives_ns.values())
    assert abs(given_up_ns - usual_ns[50] - around_ns) <= MS // 20


def test_busy_waits_become_rare_where_they_make_truth_late() -> None:
    predictor = ArrivalPredictor(MS)
    predictor.update(0, -MS // 10, MS // 4, 0)

    def windows(count: int, harmful: bool) -> list[int]:
        """The shots among the first `count` for which the feed busy-waits."""
        opened = []
        for shot in range(count):
            is_open = predictor.window(shot * PERIOD_NS).closes_ns != 0
            opened += [shot] * is_open
            if is_open and harmful:
                predictor.missed()
            else:
                predictor.update(shot * PERIOD_NS, shot * PERIOD_NS - MS // 10, MS // 4, 0)
        return opened

    assert windows(255, harmful=True) == [0, 2, 6, 14, 30, 62, 126, 190, 254]
    assert windows(100, harmful=False) == list(range(63, 100))
    assert windows(7, harmful=True) == [0, 2, 6]


def test_on_a_slow_machine_busy_waits_take_no_more_than_their_share() -> None:
    """Nor is there time for a warm-up, except before the first shot."""
    world = World(50)
    world.shot_takes_ns = 20 * MS
    truths = [(START_NS + world.due_ns(k), truth(k, 1)._replace(time_ns=world.seen_ns(k))) for k in range(50)]
    fly_live(world, [(START_NS - MS, truth(0, MS)), *truths], lead_s=0)
    assert len(world.computed) == 50
    assert [shot for shot, _ in world.warmed_up] == [0]
    assert max(end_ns - began_ns for began_ns, end_ns in world.busy) == PERIOD_NS // 10


def test_where_cores_are_few_there_is_no_busy_wait() -> None:
    world = World(10)
    truths = [(START_NS + world.due_ns(k), truth(k, 1)._replace(time_ns=world.seen_ns(k))) for k in range(10)]
    fly_live(world, [(START_NS - MS, truth(0, MS)), *truths], busy_wait_share=0, lead_s=0)
    assert len(world.computed) == 10
    assert (world.busy, world.warmed_up, world.wake_ups) == ([], [], [])


def test_the_port_process_is_woken_for_a_packet_that_is_due_as_soon_as_it_is_made() -> None:
    for after_seen_ns, woken in ((MS // 2, False), (2 * MS, True)):
        world = World(10)
        truths = [
            (START_NS + world.seen_ns(k) + after_seen_ns, truth(k, 1)._replace(time_ns=world.seen_ns(k)))
            for k in range(10)
        ]
        fly_live(world, [(START_NS - MS, truth(0, MS)), *truths], lead_s=0)
        assert [at_ns for _, at_ns, _ in world.computed] == [at_ns for at_ns, _ in truths]
        assert world.wake_ups == ([at_ns for at_ns, _ in truths] if woken else [])


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
    changes = [(arrived_ns, to_pattern(1, arrived_ns))]
    PlannedFeed(*shared(world, changes), first, 30, START_NS, Pace.WALL).run()
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
    first = block_of(world, 1)
    asked_ns = world.now
    PlannedFeed(*shared(world), first, 30, None, Pace.WALL).run()
    assert world.begun == [(asked_ns + 10 * MS * (computed - 1) + 100 * MS, computed)]
    assert [shot for shot, _ in world.sent] == list(range(200))


@pytest.mark.parametrize("slow", [False, True])
def test_no_change_takes_effect_before_one_that_was_heard_earlier(slow: bool) -> None:
    """What needs time to prepare, and a command right after it: going back beyond the first would undo it."""
    world, followed = World(200), list[Any]()
    world.room = 5 if slow else 100
    ready_ns, at_ns = START_NS + 1300 * MS, START_NS + 1000 * MS
    changes = [(at_ns, to_pattern(1, ready_ns, followed)), (at_ns, to_pattern(2, at_ns, followed))]
    first = block_of(world, 5)
    PlannedFeed(*shared(world, changes), first, 5, START_NS, Pace.WALL).run()
    assert followed == [(1, 26, ready_ns), (2, 26, ready_ns)]
    assert [pattern for _, pattern in world.sent] == [0] * 26 + [2] * 174


def test_what_no_shot_follows_any_more_is_reported_at_the_end() -> None:
    """The last shot begins at 9950 ms; its packet is due 3 ms later."""
    world, followed = World(200), list[Any]()
    times_ns = [START_NS + t * MS for t in (9951, 9952)]
    changes = [(at_ns, to_pattern(k, at_ns, followed)) for k, at_ns in enumerate(times_ns)]
    at_work = shared(world, [(at_ns - 3 * MS, change) for at_ns, change in changes])
    PlannedFeed(*at_work, block_of(world, 30), 30, START_NS, Pace.WALL).run()
    assert followed == []
    at_work[-1].close()
    assert followed == [(0, None, None), (1, None, None)]


def test_live_shots_follow_what_came_before_they_began() -> None:
    world, followed = World(40), list[Any]()
    truths = [(START_NS + k * 10 * MS, truth(k, 10 * MS)) for k in range(1, 300)]
    socket: Any = Socket(world, [(START_NS - MS, truth(0, MS)), *truths])
    source = TruthSource(socket, LiveTrajectory(100 * MS), 100 * MS, [], [])
    times_ns = [START_NS + t * MS for t in (240, 251, 270, 2500)]
    changes = [(START_NS + 200 * MS, to_pattern(k, at_ns, followed)) for k, at_ns in enumerate(times_ns)]
    at_work = shared(world, changes)
    LiveFeed(*at_work, source, timing(Live(kind="live")), "coast", Machine()).run()
    assert [(number, shot) for number, shot, _ in followed] == [(0, 5), (1, 6), (2, 6)]
    at_work[-1].close()
    assert followed[-1] == (3, None, None)


def test_what_a_silent_device_does_not_send_is_not_late() -> None:
    world = World(40)
    world.stalls, world.silent = {10: 420 * MS}, {13, 14, 15}
    truths = [(START_NS + k * 10 * MS, truth(k, 10 * MS)) for k in range(1, 300)]
    fly_live(world, [(START_NS - MS, truth(0, MS)), *truths])
    assert world.never == [11, 12, 16, 17]
    assert sorted([shot for shot, _, _ in world.computed] + world.never) == list(range(40))

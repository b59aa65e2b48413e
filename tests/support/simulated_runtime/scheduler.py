"""A deterministic scheduler: processes run one at a time, each until it reads the clock or waits, in simulated time.

A process is a greenlet. At each reading of the clock some time passes, and the
process may lose its processor: for a moment, because another process or the world outside has something to do first, or
for a stall. All of this is drawn from one generator.
"""

from __future__ import annotations

import heapq
import select
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from random import Random
from typing import NamedTuple, Protocol

from greenlet import getcurrent, greenlet

from lidar_emu.runtime.clock import Clock

START_NS = 5_000_000_000_000
SIMULATED_DESCRIPTORS = 1_000_000
"""Descriptors from this number on are not the system's."""
_FAR_NS = 1 << 62
_LOOKS_EVERY = 0.1


class Killed(BaseException):
    """The process was killed: raised by its next call of the clock."""


class Failure(AssertionError):  # noqa: N818
    """An invariant does not hold."""


class Device(Protocol):
    """What a simulated descriptor stands for."""

    def is_readable(self) -> bool: ...
    def is_writable(self) -> bool: ...


class _Waits(NamedTuple):
    readable: Sequence[int]
    writable: Sequence[int]


class Process:
    """A process of the simulation."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.greenlet = getcurrent()
        self.wakes_ns = START_NS
        self.waits: _Waits | None = None
        self.stalled_ns = 0
        self.processor_ns = 0
        self.killed = self.ended = False


class Scheduler:
    """The processes, the world's timed actions, and the clock.

    Args:
        random: draws everything that is not planned.
        tick_ns: longest time between two readings of the clock.
        wake_ns: longest time from an event to the process that waits for it.
        preempted: probability, at a reading of the clock, of losing the processor for a while.
        ends_ns: a run that goes on after this time fails.
    """

    def __init__(self, random: Random, tick_ns: int, wake_ns: int, preempted: float, limit_ns: int) -> None:
        self.random = random
        self.now_ns = START_NS
        self.devices: dict[int, Device] = {}
        self.utc_step = timedelta()
        self.after_step: Callable[[], None] = lambda: None
        """Checks what must hold whenever a process or the world outside has done something."""
        self.failure: BaseException | None = None
        self.model = self.running = Process("model")
        self._others: list[Process] = []
        self._tick_ns, self._wake_ns, self._preempted = tick_ns, wake_ns, preempted
        self._ends_ns = START_NS + limit_ns
        self._actions: list[tuple[int, int, Callable[[], None]]] = []
        self._numbered = 0
        self._looks_ns = 0
        self._then: Process | None = None
        self._interrupt: Callable[[], None] | None = None

    # What the world does

    def at(self, time_ns: int, action: Callable[[], None]) -> None:
        """Let the world do something at an instant."""
        self._numbered += 1
        heapq.heappush(self._actions, (time_ns, self._numbered, action))
        self._looks_ns = min(self._looks_ns, time_ns)

    def stall(self, process: Process, duration_ns: int) -> None:
        """Take the processor from a process for some time."""
        process.stalled_ns = max(process.stalled_ns, self.now_ns + duration_ns)

    def interrupt(self, raise_signal: Callable[[], None]) -> None:
        """Raise a signal in the model process as soon as it runs."""
        self._interrupt = raise_signal

    # What processes do

    def read(self) -> int:
        """Read the monotonic clock; time passes."""
        me = self.running
        self._die(me)
        random = self.random.random
        cost_ns = int(random() * self._tick_ns)
        self.now_ns += cost_ns
        me.processor_ns += cost_ns
        if random() < self._preempted:
            me.wakes_ns = self.now_ns + int(10 ** (3 + 4 * random()))
            self._switch(me)
        elif self.now_ns >= self._looks_ns or random() < _LOOKS_EVERY:
            me.wakes_ns = self.now_ns
            self._switch(me)
        return self.now_ns

    def spend(self, duration_ns: int) -> None:
        """Compute for some time."""
        me = self.running
        self._die(me)
        me.processor_ns += duration_ns
        me.wakes_ns = self.now_ns + duration_ns
        self._switch(me)

    def wait(
        self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]
    ) -> tuple[list[int], list[int]]:
        """Wait until an instant or for a descriptor; return those that are ready."""
        me = self.running
        while True:
            self._die(me)
            ready = self._ready(readable, writable)
            if ready[0] or ready[1] or (until_ns is not None and until_ns <= self.now_ns):
                return ready
            me.wakes_ns = _FAR_NS if until_ns is None else until_ns + self._latency_ns()
            me.waits = _Waits(readable, writable)
            self._switch(me)

    def start(self, name: str, run: Callable[[], None], control: int) -> Process:
        """Start a process once a descriptor is readable."""
        process = Process(name)
        process.wakes_ns, process.waits = _FAR_NS, _Waits([control], [])
        self._others.append(process)

        def body() -> None:
            try:
                run()
            except Killed:
                pass
            except BaseException as error:
                self.failure = self.failure or error
            process.ended = True
            self._others.remove(process)
            if self._then is None:
                self.running = self._choose(process)
                getcurrent().parent = self.running.greenlet
            else:
                getcurrent().parent = self._then.greenlet

        process.greenlet = greenlet(body)
        return process

    def kill(self, process: Process) -> None:
        """Kill a process. It runs no further than to its next call of the clock, which it is in."""
        if process.ended or process.killed:
            return
        process.killed = True
        if process is self.running or process is self.model:
            return  # it unwinds once it runs
        killer = self.running
        self._run(process, then=killer)
        self.running = killer

    def outlive(self) -> None:
        """Let the other processes go on after the end of the model process, until they have ended."""
        self.model.wakes_ns, self.model.waits = _FAR_NS, None
        while self._others and self.failure is None:
            self._run(self._choose(self.model), then=self.model)
        self.running = self.model
        for process in [*self._others]:
            self.kill(process)

    # Inside

    def check(self) -> None:
        """End a process that was killed."""
        self._die(self.running)

    def _die(self, me: Process) -> None:
        if me.killed or self.failure is not None:
            raise Killed

    def _latency_ns(self) -> int:
        return int(self.random.random() * self._wake_ns)

    def _ready(self, readable: Sequence[int], writable: Sequence[int]) -> tuple[list[int], list[int]]:
        real_in = [each for each in readable if each < SIMULATED_DESCRIPTORS]
        real_out = [each for each in writable if each < SIMULATED_DESCRIPTORS]
        ready_in, ready_out, _ = (
            select.select(real_in, real_out, (), 0) if real_in or real_out else ([], [], [])
        )
        devices = self.devices
        ready_in += [n for n in readable if n >= SIMULATED_DESCRIPTORS and devices[n].is_readable()]
        ready_out += [n for n in writable if n >= SIMULATED_DESCRIPTORS and devices[n].is_writable()]
        return ready_in, ready_out

    def _switch(self, me: Process) -> None:
        """Let others run until it is this process's turn again."""
        chosen = self._choose(me)
        if chosen is not me:
            self._run(chosen, then=None)
        self._die(me)
        if me is self.model and self._interrupt is not None:
            raise_signal, self._interrupt = self._interrupt, None
            raise_signal()

    def _run(self, process: Process, then: Process | None) -> None:
        """Continue a process; at its end, `then` runs next (None: who is due)."""
        self._then, self.running = then, process
        process.greenlet.switch()

    def _choose(self, me: Process) -> Process:
        while True:
            try:
                self.after_step()
            except Failure as failure:
                self.failure = self.failure or failure
            if self.failure is not None:
                return self.model
            chosen = self._first()
            if self._actions and self._actions[0][0] <= max(_due(chosen), self.now_ns):
                time_ns, _, action = heapq.heappop(self._actions)
                self.now_ns = max(self.now_ns, time_ns)
                try:
                    action()
                except BaseException as error:
                    self.failure = error
                if me.killed and not me.ended:
                    return me
                continue
            if max(self.now_ns, _due(chosen)) > self._ends_ns:
                self.failure = Failure("the run does not end")
                continue
            self.now_ns = max(self.now_ns, _due(chosen))
            chosen.waits = None
            self._looks_ns = min(
                [_due(each) for each in (self.model, *self._others) if each is not chosen]
                + [self._actions[0][0] if self._actions else _FAR_NS]
            )
            return chosen

    def _first(self) -> Process:
        processes = [self.model, *self._others]
        for process in processes:
            if process.waits is not None and any(self._ready(*process.waits)):
                process.waits = None
                process.wakes_ns = min(process.wakes_ns, self.now_ns + self._latency_ns())
        return min(processes, key=lambda process: max(_due(process), self.now_ns))


def _due(process: Process) -> int:
    return max(process.wakes_ns, process.stalled_ns)


class SimulatedClock(Clock):
    """The clock of all processes."""

    def __init__(self, scheduler: Scheduler, epoch: datetime = datetime(2030, 1, 1, tzinfo=UTC)) -> None:
        self._scheduler, self._epoch = scheduler, epoch

    def now_ns(self) -> int:
        return self._scheduler.read()

    def processor_time_ns(self) -> int:
        return self._scheduler.running.processor_ns

    def utc_now(self) -> datetime:
        since = timedelta(microseconds=(self._scheduler.read() - START_NS) / 1000)
        return self._epoch + since + self._scheduler.utc_step

    def wait(
        self,
        until_ns: int | None,
        readable: Sequence[int] = (),
        writable: Sequence[int] = (),
        busy_wait: bool = False,  # noqa: ARG002
    ) -> tuple[list[int], list[int]]:
        return self._scheduler.wait(until_ns, readable, writable)

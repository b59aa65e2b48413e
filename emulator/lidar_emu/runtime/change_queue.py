"""Changes to upcoming shots, from commands, injected faults and the system clock, in order of arrival."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.state import DeviceState
from lidar_emu.errors import InputError
from lidar_emu.runtime.clock import Clock, Discipline
from lidar_emu.session import Session

if TYPE_CHECKING:
    from lidar_emu.runtime.port.runner import PortRunner


class Change(NamedTuple):
    """A change to upcoming shots."""

    apply: Callable[[Session], None]
    """Applies it to the session, from its next shot on."""
    arrived_ns: int
    """Instant of the monotonic clock at which it arrived or, if later, from which on it can be applied."""
    applied: Callable[[int | None, int | None], None] | None = None
    """Called with the first shot that the change affects (None: no shot is left) and the instant of the monotonic clock
    at which that shot begins (None: that clock does not set the pace)."""


NamedCommand = tuple[str, Mapping[str, int | float | str]]
"""Name of a command, and its arguments by name."""
CommandResult = dict[str, Any]
"""`verdict`, None where the device does not answer, and `time_s` by its clock."""
Execute = Callable[[Sequence[NamedCommand], int], tuple[list[Change], list[CommandResult]]]
"""Executes commands that arrived at an instant of the monotonic clock."""


class CommandReceiver(Protocol):
    """Executes received commands: a `CommandHandler`."""

    def receive(self, data: bytes, arrived_ns: int, time_ns: int, pulse_ns: int | None) -> list[Change]:
        """Execute and acknowledge the commands in these bytes."""

    def execute(
        self, commands: Sequence[NamedCommand], arrived_ns: int, time_ns: int
    ) -> tuple[list[Change], list[CommandResult]]:
        """Execute commands that did not come through the port; return their results."""


class FaultReceiver(Protocol):
    """Receives what arrives on the control socket: a `FaultInjector`."""

    def receive(self, execute: Execute) -> list[Change]:
        """Check and answer the faults that have arrived; pass commands on to `execute`."""


_POLL_NS = 100_000_000


class SystemClockFollower:
    """Lets the device's clock follow the system clock: its steps, and whether a program keeps it.

    Args:
        epoch_utc_ns: epoch of the device's clock, nanoseconds since 1970.
    """

    def __init__(self, device: DeviceTimeline, epoch_utc_ns: int, clock: Clock) -> None:
        self._device, self._epoch_utc_ns, self._clock = device, epoch_utc_ns, clock
        part = device.constants.clock
        self._lock_ns = round((part.lock_s or 0.0) * 1e9)
        holdover_ns = None if part.holdover_s is None else round(part.holdover_s * 1e9)
        self._discipline = Discipline(holdover_ns)
        self._polls_ns = 0

    def receive(self, start_ns: int) -> list[Change]:
        """The change since the last call, if there is one.

        Args:
            start_ns: instant of the monotonic clock at scenario time 0.
        """
        now_ns = self._clock.now_ns()
        if now_ns < self._polls_ns:
            return []
        self._polls_ns, system = now_ns + _POLL_NS, self._clock.system_time()
        self._discipline.update(now_ns, system)
        state = self._device.at(now_ns - start_ns)
        epoch_ns = self._epoch_utc_ns - system.ahead_ns - start_ns
        if abs(epoch_ns - state.clock.epoch_ns) <= 2 * system.uncertainty_ns:
            epoch_ns = state.clock.epoch_ns
        after = self._device.use_system_clock(
            now_ns - start_ns, epoch_ns, self._is_locked(state, start_ns, now_ns)
        )
        return [] if after is None else [Change(lambda session: session.use_device(after), now_ns)]

    def _is_locked(self, state: DeviceState, start_ns: int, now_ns: int) -> bool:
        since_ns = self._discipline.since_ns
        if since_ns is None or state.clock_locked:
            return since_ns is not None
        return now_ns >= max(since_ns, start_ns + state.restarted_ns) + self._lock_ns


class ChangeQueue:
    """Queue of pending changes, applied in order of arrival: none takes effect before an earlier one.

    Args:
        port: port on which commands arrive.
        commands: handles received commands; None: the interface has no commands.
        injector: receives faults injected in flight, and commands beside the port; None: the run accepts none.
        system_clock: lets the device's clock follow the system clock; None: it does not.
    """

    def __init__(
        self,
        port: PortRunner,
        commands: CommandReceiver | None,
        injector: FaultReceiver | None,
        system_clock: SystemClockFollower | None = None,
    ) -> None:
        self._port, self._commands, self._injector = port, commands, injector
        self._system_clock = system_clock
        self._pending: deque[Change] = deque()
        self._executed_ns = 0

    def receive(self, time_ns: int, start_ns: int | None = None) -> None:
        """Process received commands and faults.

        Args:
            time_ns: scenario time.
            start_ns: instant of the monotonic clock at scenario time 0, if that clock sets the pace: the time of a
                command is then its arrival, and the time at the tone is the last pulse.
        """
        if self._commands is not None:
            for arrived_ns, data, pulse_ns in self._port.take_received():
                # The device's time never goes back: a command on the control socket may have overtaken this one.
                at_ns = max(arrived_ns, self._executed_ns)
                if start_ns is None:
                    self._pending += self._commands.receive(data, at_ns, time_ns, None)
                else:
                    tone_ns = None if pulse_ns is None else pulse_ns - start_ns
                    self._pending += self._commands.receive(data, at_ns, at_ns - start_ns, tone_ns)
        if self._injector is not None:
            self._pending += self._injector.receive(partial(self._execute, time_ns, start_ns))
        if self._system_clock is not None and start_ns is not None:
            changes = self._system_clock.receive(start_ns)
            self._executed_ns = max([self._executed_ns, *(change.arrived_ns for change in changes)])
            self._pending += changes

    def _execute(
        self, time_ns: int, start_ns: int | None, commands: Sequence[NamedCommand], arrived_ns: int
    ) -> tuple[list[Change], list[CommandResult]]:
        if self._commands is None:
            remedy = "the interface of the run has no commands on this link"
            raise InputError("command", None, commands[0][0] if commands else None, remedy)
        self._executed_ns = arrived_ns
        at_ns = time_ns if start_ns is None else arrived_ns - start_ns
        return self._commands.execute(commands, arrived_ns, at_ns)

    @property
    def first(self) -> Change | None:
        """The oldest pending change."""
        return self._pending[0] if self._pending else None

    def apply_first(self, session: Session, begins_ns: int | None) -> None:
        """Apply the oldest change from the session's next shot on.

        Args:
            begins_ns: instant of the monotonic clock at which that shot begins; None if that clock does not set the
                pace.
        """
        change = self._pending.popleft()
        change.apply(session)
        if change.applied is not None:
            change.applied(session.next_shot, begins_ns)

    def close(self) -> None:
        """End the queue: no shot is left that pending changes could affect."""
        while self._pending:
            if (applied := self._pending.popleft().applied) is not None:
                applied(None, None)


class ReceivedMessage(NamedTuple):
    """A message of the host that is no command, valid or not."""

    time_ns: int
    """Scenario time of its arrival; before the flight, time from power-up."""
    arrived_ns: int
    """The same on the monotonic clock of the computer."""
    device_ns: int
    """The same on the clock of the device."""
    message: str
    sequence: int | None
    verdict: str
    """`accepted`, `malformed` or `out_of_range`."""
    values: Mapping[str, int | float | None]
    """Fields by key; none unless it is accepted."""


class ReceivedCommand(NamedTuple):
    """A command, valid or not, and its verdict."""

    time_ns: int
    """Scenario time; before the flight, time from power-up."""
    command: str | int | None
    """Its name; the code of an unreadable command; None if that is missing, too."""
    values: Mapping[str, int | float | str | None]
    sequence: int | None
    verdict: str
    tone_ns: int | None = None
    """Scenario time of the last pulse before it, or of its arrival if it counts from a later one; None: there was no
    pulse, or the port has no pulse line."""

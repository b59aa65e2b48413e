"""Changes to upcoming shots, from commands and injected faults, in order of arrival."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple, Protocol

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


class CommandReceiver(Protocol):
    """Executes received commands: a `CommandHandler`."""

    def receive(self, data: bytes, arrived_ns: int, time_ns: int, pulse_ns: int | None) -> list[Change]:
        """Execute and acknowledge the commands in these bytes."""


class FaultReceiver(Protocol):
    """Receives faults injected in flight: a `FaultInjector`."""

    def receive(self) -> list[Change]:
        """Check and answer the faults that have arrived."""


class ChangeQueue:
    """Queue of pending changes, applied in order of arrival: none takes effect before an earlier one.

    Args:
        port: port on which commands arrive.
        commands: handles received commands; None: the interface has no commands.
        injector: receives faults injected in flight; None: the run accepts none.
    """

    def __init__(
        self, port: PortRunner, commands: CommandReceiver | None, injector: FaultReceiver | None
    ) -> None:
        self._port, self._commands, self._injector = port, commands, injector
        self._pending: deque[Change] = deque()

    def receive(self, time_ns: int, start_ns: int | None = None) -> None:
        """Process received commands and faults.

        Args:
            time_ns: scenario time.
            start_ns: instant of the monotonic clock at scenario time 0, if that clock sets the pace: the time of a
                command is then its arrival, and the time at the tone is the last pulse.
        """
        if self._commands is not None:
            for at_ns, data, pulse_ns in self._port.take_received():
                if start_ns is None:
                    self._pending += self._commands.receive(data, at_ns, time_ns, None)
                else:
                    tone_ns = None if pulse_ns is None else pulse_ns - start_ns
                    self._pending += self._commands.receive(data, at_ns, at_ns - start_ns, tone_ns)
        if self._injector is not None:
            self._pending += self._injector.receive()

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
    """Scenario time of the last pulse before it; None: there was none, or the port has no pulse line."""

"""What every way of feeding the port shares."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

from lidar_emu.runtime.change_queue import Changes
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.device_link.command_handler import CommandHandler
from lidar_emu.runtime.feed.packet_queue import PacketQueue
from lidar_emu.runtime.port.packets import Outgoing, Report
from lidar_emu.session import Session

if TYPE_CHECKING:
    from lidar_emu.runtime.fault_injector import FaultInjector

POLL_NS = 20_000_000
"""How long an interruption may go unseen."""


class Desk(NamedTuple):
    """What a feed works with."""

    session: Session
    outbox: PacketQueue
    clock: Clock
    interrupted: Callable[[], bool]
    fail: Callable[[str], None]
    """End the run with an error."""
    begin: Callable[[int], None]
    """Tell the port that scenario time 0 is at this instant of the monotonic clock."""
    changes: Changes
    """What shots are to follow."""
    commands: CommandHandler | None
    """Where a host is heard; None where the interface has no commands."""
    injector: FaultInjector | None = None
    """Where faults are ordered in flight."""

    def push(self, packet: Outgoing) -> bool:
        """Hand a packet over, waiting for room; False if the run was interrupted meanwhile."""
        while not self.outbox.push(packet):
            self.rest()
            if self.interrupted():
                return False
        return True

    def rest(self) -> list[Report]:
        """Wait a little for the port, and hear it; returns reports of packets."""
        self.outbox.wait(self.clock.now_ns() + POLL_NS)
        return self.outbox.settle()

    def hear(self, time_ns: int, start_ns: int | None = None) -> None:
        """Hear the host.

        Args:
            time_ns: scenario time.
            start_ns: instant of the monotonic clock at scenario time 0, where that clock sets the pace: commands then
                count from when they came, and the time at the tone from the last pulse.
        """
        for at_ns, data, pulse_ns in self.outbox.arrivals():
            if self.commands is None:
                continue
            if start_ns is None:
                self.commands.hear(data, at_ns, time_ns)
            else:
                tone_ns = None if pulse_ns is None else pulse_ns - start_ns
                self.commands.hear(data, at_ns, at_ns - start_ns, tone_ns)
        if self.injector is not None:
            self.injector.hear()

    def follow(self, begins_ns: int | None) -> None:
        """Let the next shot be the first to follow the oldest change.

        Args:
            begins_ns: when it begins, on the monotonic clock; None where that clock does not set the pace.
        """
        self.changes.follow(self.session, begins_ns)

    def finish(self) -> None:
        """Say that no more packets will come, and wait until the port is through with them."""
        if not self.interrupted():
            self.outbox.last_packet_pushed()
        while not (self.outbox.through or self.interrupted()):
            self.rest()


class Feed(Protocol):
    """Where the shots of a run come from."""

    def fly(self) -> None:
        """Until the end, or until the run is interrupted."""
        ...

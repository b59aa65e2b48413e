"""A run that a late packet ends."""

from __future__ import annotations

from collections.abc import Callable

from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import DeliveryStatus, Outgoing, Report


class AbortOnLate(Observer):
    """Ends the run with the first shot that is late.

    Args:
        fail: told why.
    """

    def __init__(self, fail: Callable[[str], None]) -> None:
        self._fail = fail

    def on_report(self, packet: Outgoing, report: Report) -> None:  # noqa: ARG002
        """The delivery status of a packet is known."""
        if report.status is DeliveryStatus.LATE:
            late_ms = (report.woke_ns - report.due_ns) * 1e-6
            self._fail(f"shot {report.shot} was {late_ms:.3f} ms late, and timing.when_late is abort")

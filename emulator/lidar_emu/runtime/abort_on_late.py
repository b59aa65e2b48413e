"""`timing.when_late: abort`: ends a run at its first late shot."""

from __future__ import annotations

from collections.abc import Callable

from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket


class AbortOnLate(Observer):
    """Ends the run at the first late shot.

    Args:
        fail: ends the run with an error.
    """

    def __init__(self, fail: Callable[[str], None]) -> None:
        self._fail = fail

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:  # noqa: ARG002
        """End the run if the packet was late."""
        if report.status is DeliveryStatus.LATE:
            late_ms = (report.woke_ns - report.due_ns) * 1e-6
            self._fail(f"shot {report.shot} was {late_ms:.3f} ms late, and timing.when_late is abort")

"""The final message: if one of the emulator's processes dies, the host is still informed that the device is safe."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.device_link.encoder import DownlinkEncoder, housekeeping_layouts
from lidar_emu.runtime.device_link.housekeeping import HousekeepingSender
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket
from lidar_emu.runtime.port.parent_death import result_text
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_protocol import Interface

_PERIOD_NS = 1_000_000_000
_NEVER_LATE_NS = 10_000_000_000
_ENDS_WITH_PORT_PROCESS = (Kind.PTY, Kind.LOOPBACK, Kind.TCP, Kind.UNIX)


def why_no_final_message(interface: Interface, can: bool) -> str | None:
    """Why there is no final message on such a link; None if there is one."""
    fields = (placed.field for layout in housekeeping_layouts(interface, can) for placed in layout.placed)
    known = (interface.enumerations.get(field.enumeration or "") for field in fields if field.name == "mode")
    if any(words and "safe" in words for words in known):
        return None
    lacks = f"interface {interface.name} has no housekeeping with mode safe on this link"
    return f"{lacks}: nothing is sent if a process dies"


class FinalMessage(Observer):
    """Housekeeping with mode safe, prepared every second, because it cannot be composed once a process has died.

    Args:
        encoder: encoder of the downlink.
        housekeeping: composes the message; None: the interface has no housekeeping.
        prepare: gives the message to the port process.
    """

    def __init__(
        self,
        encoder: DownlinkEncoder,
        housekeeping: HousekeepingSender | None,
        prepare: Callable[[bytes], None],
    ) -> None:
        is_possible = why_no_final_message(encoder.interface, encoder.can) is None
        self._housekeeping = housekeeping if is_possible else None
        self._prepare = prepare
        self._time_ns = self._prepared_ns = 0
        self.result: str | None = None
        """Delivery status of the message; None: it was not needed."""

    def payload(self) -> bytes:
        """The message as of the last report, as the port process takes it; empty if there is none."""
        if self._housekeeping is None:
            return b""
        return self._housekeeping.encoded(self._time_ns, mode="safe", laser_on=False, laser_power_w=0.0)

    def on_opened(self, port: str, start: datetime) -> None:  # noqa: ARG002
        """Prepare the first message as the flight begins."""
        self._prepare(self.payload())

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:  # noqa: ARG002
        """Prepare a new message every second."""
        self._time_ns = report.due_ns
        if report.due_ns - self._prepared_ns >= _PERIOD_NS:
            self._prepared_ns = report.due_ns
            self._prepare(self.payload())

    def send(self, spec: PortSpec, clock: Clock) -> None:
        """Reopen the port and send the message, after the port process has died."""
        message = self.payload()
        if not message:
            self.result = "none"
        elif spec.kind in _ENDS_WITH_PORT_PROCESS:
            self.result = "not sent: the line ended with the port process"
        else:
            self.result = _send_over_new_port(spec, message, clock)


def _send_over_new_port(spec: PortSpec, message: bytes, clock: Clock) -> str:
    try:
        with PortRunner(1, len(message)) as port:
            port.start(spec)
            port.begin(clock.now_ns(), _NEVER_LATE_NS, Pace.WALL)
            port.push(OutgoingPacket(0, 0, message))
            port.finish()
            (report,) = port.reports()
    except (InputError, RunError) as error:
        return f"not sent: {error}"
    return result_text(report.status)

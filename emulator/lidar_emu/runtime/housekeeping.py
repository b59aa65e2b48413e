"""Housekeeping: telemetry on the device itself, sent between the shots at its own rate."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import cached_property
from typing import Any

from lidar_emu._version import __version__
from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.state import Mode
from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.runtime.command_handler import CommandHandler, DownlinkEncoder, housekeeping_layouts
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket, Pace
from lidar_emu.runtime.port.process import RESULT_TEXTS
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.summary import Tally
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_protocol import EncodeError, Interface

_NO_COMMANDS = {"commands_accepted": 0, "commands_rejected": 0, "bad_bytes": 0}


class HousekeepingSender(Observer):
    """Sends housekeeping between shots: at every pace, with the device's state at the scenario time of the shot.

    Args:
        encoder: encodes it; its interface has housekeeping.
        commands: counts commands; None: the interface has none.
        send: sends a packet at once.
        observers: receive every packet, with its scenario time.
        polled: whether it is sent when the caller asks for it alone.

    Raises:
        InputError: the interface has housekeeping fields that cannot be filled.
    """

    def __init__(
        self,
        encoder: DownlinkEncoder,
        device: DeviceTimeline,
        tally: Tally,
        commands: CommandHandler | None,
        send: Callable[[bytes], None],
        observers: Sequence[Observer],
        polled: bool = False,
    ) -> None:
        self._encoder, self._polled = encoder, polled
        self._device, self._tally, self._commands = device, tally, commands
        self._send, self._observers = send, observers
        self._last_period: tuple[int, int] | None = None
        self._truth_age_s: float | None = None
        self._sent = self._lost = self._encode_failures = 0
        self._between: deque[bool] = deque()
        self._ended = False
        try:
            encoder.housekeeping(0, self.values(0) | {"mode": self._mode_word(Mode.TRACK)})
        except EncodeError as error:
            remedy = "use the fields of the default interface"
            raise InputError("wire.interface", "housekeeping", Finding(str(error)), remedy) from None

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:  # noqa: ARG002
        if not (self._ended or self._polled):
            self.send_due(packet.due_ns)

    def on_acknowledgement(self, payload: bytes, time_ns: int) -> None:  # noqa: ARG002
        self._between.append(False)

    def on_sent_between(self, time_ns: int | None) -> None:
        is_housekeeping = self._between.popleft()
        self._lost += is_housekeeping and time_ns is None

    def on_truth_used(self, shot: int, age_ns: int, truth_count: int) -> None:  # noqa: ARG002
        self._truth_age_s = age_ns * 1e-9

    def send_due(self, time_ns: int) -> None:
        """Send what is due by this scenario time; if several instants were missed, only the last one."""
        state = self._device.at(time_ns)
        rate_hz = state.settings.housekeeping_rate_hz
        if rate_hz == 0 or not state.answers:
            self._last_period = None
            return
        # A period is identified by its length and number, so that a new rate takes effect at once.
        period_ns = round(1e9 / rate_hz)
        period = period_ns, time_ns // period_ns
        if period == self._last_period:
            return
        self._last_period = period
        payload = self.encoded(time_ns)
        if not payload:
            self._encode_failures += 1
            return
        self._sent += 1
        self._between.append(True)
        self._send(payload)
        for observer in self._observers:
            observer.on_housekeeping(payload, time_ns)

    def end(self) -> None:
        """Send nothing more: the last reports arrive after the port is closed."""
        self._ended = True

    def start_flight(self) -> None:
        """Restart the periods, since scenario time restarts at 0."""
        self._last_period = None

    def encoded(self, time_ns: int, **replaced: Any) -> bytes:
        """The packet at a scenario time, with some values replaced; empty if a value does not fit its field."""
        try:
            return self._encoder.housekeeping(self._sent, self.values(time_ns) | replaced)
        except EncodeError:
            return b""

    def values(self, time_ns: int) -> dict[str, Any]:
        """Values at a scenario time, by the names of the fields."""
        state = self._device.at(time_ns)
        shown_ns = state.clock.reads_ns(time_ns)
        major, minor, patch = (int(part) for part in __version__.split(".")[:3])
        return {
            "time_ns": shown_ns,
            "time_s": shown_ns * 1e-9,
            "software_major": major,
            "software_minor": minor,
            "software_patch": patch,
            "mode": self._mode_word(state.mode),
            "interlock_closed": state.interlock_closed,
            "laser_on": state.measures,
            "clock_locked": state.clock_locked,
            "temperature_c": state.thermal.temperature_c(time_ns),
            "laser_power_w": self._device.constants.laser_power_w if state.measures else 0.0,
            "uptime_s": max(0, time_ns - state.restarted_ns) // 10**9,
            "shots_dropped": self._tally.dropped,
            "shots_late": self._tally.late,
            "truth_age_s": self._truth_age_s,
            **(_NO_COMMANDS if self._commands is None else self._commands.counts),
        }

    def to_json(self) -> dict[str, int]:
        """The counts, by the keys of the summary file."""
        return {"sent": self._sent - self._lost, "encode_failures": self._encode_failures}

    def _mode_word(self, mode: Mode) -> str:
        """Word of the interface for the mode, or for the nearest mode that it has."""
        known = self._encoder.interface.enumerations.get(self._mode_enumeration or "", {})
        nearest = (mode, Mode.TRACK if mode is Mode.ACQUIRE else Mode.STANDBY)
        return next((word for word in nearest if word in known), mode)

    @cached_property
    def _mode_enumeration(self) -> str | None:
        layouts = housekeeping_layouts(self._encoder.interface, self._encoder.can)
        fields = (placed.field for layout in layouts for placed in layout.placed)
        return next((field.enumeration for field in fields if field.name == "mode"), None)


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
        self._ended = False
        self.result: str | None = None
        """Delivery status of the message; None: it was not needed."""

    def payload(self) -> bytes:
        """The message as of the last report, as the port process takes it; empty if there is none."""
        if self._housekeeping is None:
            return b""
        return self._housekeeping.encoded(self._time_ns, mode="safe", laser_on=False, laser_power_w=0.0)

    def on_opened(self, port: str, start: datetime) -> None:  # noqa: ARG002
        self._prepare(self.payload())

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:  # noqa: ARG002
        self._time_ns = report.due_ns
        if not self._ended and report.due_ns - self._prepared_ns >= _PERIOD_NS:
            self._prepared_ns = report.due_ns
            self._prepare(self.payload())

    def end(self) -> None:
        """Prepare nothing more: the last reports arrive after the port is closed."""
        self._ended = True

    def send(self, spec: PortSpec, machine: Machine) -> None:
        """Reopen the port and send the message, after the port process has died."""
        message = self.payload()
        if not message:
            self.result = "none"
        elif spec.kind in _ENDS_WITH_PORT_PROCESS:
            self.result = "not sent: the line ended with the port process"
        else:
            self.result = _send_over_new_port(spec, message, machine)


def _send_over_new_port(spec: PortSpec, message: bytes, machine: Machine) -> str:
    try:
        with PortRunner(1, len(message), machine=machine) as port:
            port.start(spec)
            port.begin(machine.clock.now_ns(), _NEVER_LATE_NS, Pace.WALL)
            port.push(OutgoingPacket(0, 0, message))
            port.finish()
            (report,) = port.reports()
    except (InputError, RunError) as error:
        return f"not sent: {error}"
    return RESULT_TEXTS[report.status]

"""Preparation of a run before its port is opened: device, session, first shots, and the room that packets need."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any

from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import DeviceConstants, Mode, device_constants
from lidar_emu.errors import InputError
from lidar_emu.runtime.command_handler import DownlinkEncoder
from lidar_emu.runtime.feed.planned import PlannedShots
from lidar_emu.runtime.housekeeping import why_no_final_message
from lidar_emu.runtime.options import RunOptions, StartEvent, live_part, start_of
from lidar_emu.runtime.port.packets import Pace, payload_of
from lidar_emu.scenario.schema import Scenario
from lidar_emu.scenario.trajectory import Live
from lidar_emu.session import Session
from lidar_emu.shots.model import Model
from lidar_emu.transports.spec import Kind, PortSpec, check_wire_load, wire_load
from lidar_emu.wire import Encoder

if TYPE_CHECKING:
    from lidar_emu.faults.packets import FaultyEncoder

_LOOK_AHEAD_S = 2.0
_BLOCK_S = 0.25
_PACKET_ROOM_BYTES = 8192
_STUFFING_BYTES = 256


@dataclass(frozen=True)
class PreparedRun:
    """A run that is ready to start."""

    scenario: Scenario
    model: Model
    port: PortSpec
    """The port, with what scenario and interface state of it."""
    live: Live | None
    """The live trajectory; None if the scenario has another one."""
    start: StartEvent | datetime
    """Event, or UTC instant of scenario time 0."""
    encoder: Encoder
    downlink: DownlinkEncoder
    device: DeviceTimeline
    session: Session
    shots: PlannedShots
    slots: int
    """Packets that may be on their way at a time."""
    port_faults: list[dict[str, Any]] | None
    """Faults of the port; None if there are none and none can be injected."""
    packet_bytes: int
    """The longest packet without faults, as the port takes it."""
    room_bytes: int
    """Room for one packet in the port's ring."""
    wire_load: float | None
    """Share of the link's capacity that the shots take."""
    warnings: list[str]
    """Warnings for the user."""

    @property
    def faulty_packet_bytes(self) -> int:
        """The longest packet that faults may make, so that there is room for it once it is stuffed."""
        return self.room_bytes - _STUFFING_BYTES

    def can_encode_time(self, shown_ns: int) -> bool:
        """Whether packets can hold the time up to the end of the run, once the clock was set to `shown_ns`."""
        run_ns = self.model.shot_count * self.model.period_ns
        return self.encoder.can_encode_time(self.shots.sample.measurement, shown_ns + run_ns)


def prepare(scenario: Scenario, model: Model, options: RunOptions) -> PreparedRun:
    """Prepare a run of a scenario.

    The first block is computed here: kernels are compiled, and the length of packets is known.

    Raises:
        InputError: the wire is too slow for the rate, the interface too small for the beams, or the pace or the start
            does not suit the scenario.
    """
    live, rate_hz = live_part(scenario, options), scenario.timing.rate_hz
    can, start = options.port.kind is Kind.CAN, start_of(scenario, options)
    on_command = start is StartEvent.ON_COMMAND
    encoder = Encoder(scenario.wire, can, options.port.fd, model.beam_count)
    port = replace(
        options.port.on_line(encoder.interface.serial_format),
        is_uart=scenario.wire.pty_uart and options.port.kind is Kind.PTY,
        pulse_line=scenario.device.clock.pulse_line or "",
        pulse_out=scenario.device.clock.pulse_out or "",
    )
    downlink = DownlinkEncoder(encoder.interface, scenario.wire.unit, can)
    if on_command and not downlink.has_commands:
        remedy = "requires an interface that has commands on this link"
        raise InputError("--start", None, "on-command", remedy)
    if scenario.wire.polled:
        _check_polled(downlink, options)
    faulty = faulty_encoder_of(scenario, encoder, can)
    port_faults = _port_faults(scenario, model, options)
    constants = device_constants_of(scenario, model)
    block_shots = max(1, min(128, round(rate_hz * _BLOCK_S)))
    slots = max(2 * block_shots, round(rate_hz * _LOOK_AHEAD_S))
    session = Session(model, encoder, slots + 1, faulty, constants)
    known = live is None and not on_command
    shots = PlannedShots(session, model, encoder, block_shots, known)
    longest = max((payload_of(packet) for packet in encoder.packets(shots.sample.measurement)), key=len)
    faulty_bytes = len(longest) if faulty is None else faulty.longest(len(longest))
    has_final_message = scenario.timing.when_process_dies == "safe"
    no_final_message = why_no_final_message(encoder.interface, can) if has_final_message else None
    warnings = [check_wire_load(port, longest, rate_hz), no_final_message, _check_clock(scenario, options)]
    if live is not None and live.is_open:
        forged = "one that forges an address of trajectory.allow flies the vehicle"
        warnings.append(f"{live.listen} is open to other machines: {forged}")
    if port.is_open and downlink.has_commands:
        warnings.append(f"{port} is open to other machines: any of them may command the device")
    return PreparedRun(
        scenario,
        model,
        port,
        live,
        start,
        encoder,
        downlink,
        waiting_device(constants) if on_command else DeviceTimeline(constants, initial(constants)),
        session,
        shots,
        slots,
        port_faults,
        len(longest),
        max(_PACKET_ROOM_BYTES, faulty_bytes + _STUFFING_BYTES),
        wire_load(port, longest, rate_hz),
        [warning for warning in warnings if warning],
    )


def _check_polled(downlink: DownlinkEncoder, options: RunOptions) -> None:
    commands = downlink.interface.commands
    if options.pace is not Pace.WALL:
        raise InputError(
            "wire.polled", None, True, f"must be false with --pace {options.pace}: the host polls in time"
        )
    if not downlink.has_commands or commands is None or "no_op" not in commands.by_name:
        raise InputError(
            "wire.polled", None, True, "requires an interface with the command no_op on this link"
        )


def _check_clock(scenario: Scenario, options: RunOptions) -> str | None:
    """A warning if the port has no line for the pulses of the scenario, otherwise None.

    Raises:
        InputError: the run cannot have such a clock, or two uses of one line.
    """
    clock, port = scenario.device.clock, options.port
    if clock.pulse_out == "rts" and port.rs485:
        raise InputError(scenario.name, "device.clock.pulse_out", "rts", "use dtr: --rs485 switches RTS")
    if clock.source is not None and (options.pace is not Pace.WALL or sys.platform != "linux"):
        raise InputError(
            scenario.name, "device.clock.source", clock.source, "leave it out: it needs --pace wall, on Linux"
        )
    keys = [key for key in ("pulse_line", "pulse_out") if not (getattr(clock, key) or "/").startswith("/")]
    if not keys or (port.kind is Kind.SERIAL and not port.scheme):
        return None
    return f"{port} has no modem lines: device.clock.{keys[0]} has no effect"


def waiting_device(constants: DeviceConstants) -> DeviceTimeline:
    """The device before the flight: times count from power-up, and the scenario's timed events are left out."""
    start = Mode.STANDBY if constants.start is Mode.TRACK else constants.start
    before = replace(constants, start=start, events=())
    return DeviceTimeline(before, initial(before))


def device_constants_of(scenario: Scenario, model: Model) -> DeviceConstants:
    """Constants of the device that measures a scenario."""
    return device_constants(
        scenario.device,
        scenario.timing.rate_hz,
        model.beam_count,
        model.pattern_count,
        scenario.laser_power_w,
        scenario.faults,
    )


def faulty_encoder_of(scenario: Scenario, encoder: Encoder, can: bool) -> FaultyEncoder | None:
    """The encoder with the scenario's packet faults; None, and nothing is imported, if the scenario has no faults.

    Raises:
        InputError: a fault cannot happen on this link.
    """
    if not scenario.faults:
        return None
    from lidar_emu.faults.packets import faulty_encoder

    return faulty_encoder(scenario, encoder, can)


def _port_faults(scenario: Scenario, model: Model, options: RunOptions) -> list[dict[str, Any]] | None:
    if not (scenario.faults or options.control):
        return None
    from lidar_emu.runtime.fault_injector import port_faults

    end_ns = None if scenario.live else model.shot_count * scenario.timing.period_ns
    faults = port_faults(scenario, end_ns, options.pace, options.port.kind is Kind.CAN)
    return faults if faults or options.control else None

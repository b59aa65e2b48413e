"""What there is of a run before its port is opened: device, session and first shots, and how much room they need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lidar_emu.device.modes import initial
from lidar_emu.device.rules import Rules, device_rules
from lidar_emu.device.timeline import DeviceTimeline
from lidar_emu.runtime.device_link.final_message import why_no_final_message
from lidar_emu.runtime.feed.on_command import waiting_device
from lidar_emu.runtime.feed.packet_queue import payload_of
from lidar_emu.runtime.feed.shots_ahead import ShotsAhead
from lidar_emu.runtime.options import RunOptions, live_part
from lidar_emu.runtime.port_faults import packets_on_order, port_on_order
from lidar_emu.scenario.schema import Scenario
from lidar_emu.scenario.trajectory import Live
from lidar_emu.session import Session
from lidar_emu.shots.model import Model
from lidar_emu.transports.spec import Kind
from lidar_emu.transports.wire_load import check_wire_load, wire_load
from lidar_emu.wire import Encoder

if TYPE_CHECKING:
    from lidar_emu.flight.flight import Flight

_LOOK_AHEAD_S = 2.0
_BLOCK_S = 0.25
_PACKET_ROOM_BYTES = 8192
_STUFFING_BYTES = 256


@dataclass(frozen=True)
class Prepared:
    """Of one run."""

    scenario: Scenario
    model: Model
    options: RunOptions
    live: Live | None
    """The trajectory, if a simulator flies it."""
    encoder: Encoder
    device: DeviceTimeline
    session: Session
    ahead: ShotsAhead
    slots: int
    """Packets that may be on their way at a time."""
    port_faults: list[dict[str, Any]] | None
    """See `port_on_order`."""
    packet_bytes: int
    """The longest packet without faults, as the port takes it."""
    room_bytes: int
    """What the port has room for, in place of one packet."""
    wire_load: float | None
    """How much of the link the shots take."""
    warnings: list[str]
    """What the user should know before the run."""

    @property
    def flight(self) -> Flight:
        """What is flown, where it is no bench pattern."""
        assert self.model.flight is not None
        return self.model.flight

    @property
    def is_can(self) -> bool:
        """Whether the link is a CAN bus."""
        return self.options.port.kind is Kind.CAN

    @property
    def faulty_packet_bytes(self) -> int:
        """How long faults can make a packet, so that there is room for it once it is stuffed anew."""
        return self.room_bytes - _STUFFING_BYTES

    def can_date(self, shown_ns: int) -> bool:
        """Whether packets can tell the time to the end of the run, once the clock has been set to this."""
        run_ns = self.model.shot_count * self.model.period_ns
        return self.encoder.can_date(self.ahead.first.measurement, shown_ns + run_ns)


def rules_of(scenario: Scenario, model: Model) -> Rules:
    """Of the device that measures a scenario."""
    return device_rules(
        scenario.device,
        scenario.timing.rate_hz,
        model.beam_count,
        model.pattern_count,
        scenario.laser_power_w,
        scenario.faults,
        scenario.seed,
    )


def prepared(scenario: Scenario, model: Model, options: RunOptions) -> Prepared:
    """A run of a scenario.

    The first block is computed here: kernels are compiled, and the length of packets is known.

    Raises:
        InputError: the wire is too slow for the rate, the interface too small for the beams, or the pace is none for
            this scenario.
    """
    live, port, rate_hz = live_part(scenario, options), options.port, scenario.timing.rate_hz
    can = port.kind is Kind.CAN
    encoder = Encoder(scenario.wire, can, port.fd, model.beam_count)
    faulty = packets_on_order(scenario, encoder, options)
    port_faults = port_on_order(scenario, model, options)
    rules = rules_of(scenario, model)
    block_shots = max(1, min(128, round(rate_hz * _BLOCK_S)))
    slots = max(2 * block_shots, round(rate_hz * _LOOK_AHEAD_S))
    session = Session(model, encoder, slots + 1, faulty, rules)
    known = live is None and not options.on_command
    ahead = ShotsAhead(session, model, encoder, block_shots, options.pace, known)
    longest = max((payload_of(packet) for packet in encoder.packets(ahead.first.measurement)), key=len)
    faulty_bytes = len(longest) if faulty is None else faulty.longest(len(longest))
    sends_final_message = scenario.timing.when_process_dies == "safe"
    wordless = why_no_final_message(encoder.interface, can) if sends_final_message else None
    warnings = check_wire_load(port, longest, rate_hz), wordless
    return Prepared(
        scenario,
        model,
        options,
        live,
        encoder,
        waiting_device(rules) if options.on_command else DeviceTimeline(rules, initial(rules)),
        session,
        ahead,
        slots,
        port_faults,
        len(longest),
        max(_PACKET_ROOM_BYTES, faulty_bytes + _STUFFING_BYTES),
        wire_load(port, longest, rate_hz),
        [warning for warning in warnings if warning],
    )

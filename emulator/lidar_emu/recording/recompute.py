"""Recompute a recorded run from its scenario and inputs, and compare it packet by packet."""

from __future__ import annotations

import json
import tempfile
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from lidar_emu.device.commands import DeviceCommand, DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import events_of
from lidar_emu.errors import Finding, InputError
from lidar_emu.faults.packets import faulty_encoder
from lidar_emu.recording import channels
from lidar_emu.recording.channels import JsonMessage
from lidar_emu.recording.mcap_file import NOT_A_RECORDING
from lidar_emu.recording.read import Recording, mapping_of
from lidar_emu.recording.readers import Packets
from lidar_emu.recording.write import build, interface_text
from lidar_emu.runtime.feed.base import outgoing_packets
from lidar_emu.runtime.port.packets import DeliveryStatus, OutgoingPacket
from lidar_emu.runtime.prepare import device_constants_of, faulty_encoder_of, waiting_device
from lidar_emu.scenario.load import hashed_files, read_fault
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.scenario.trajectory import Live
from lidar_emu.session import Session
from lidar_emu.shots.model import BLOCK_SHOTS, Model, build_model
from lidar_emu.trajectory.live_datagram import Truth
from lidar_emu.transports.frames import unpack_frames
from lidar_emu.transports.spec import Kind
from lidar_emu.wire import Encoder
from lidar_protocol import CanReceiver, Interface, Message, SerialReceiver


class RecordedInputs:
    """Accepted commands and injected faults, applied to a session before the shots that they affect.

    Args:
        recording: recording of the run.
        scenario: scenario of the run.
        model: model of the scenario.
        encoder: encoder of the packets.
        session: session that computes the shots again.
    """

    def __init__(
        self,
        recording: Recording,
        scenario: FlightScenario | BenchScenario,
        model: Model,
        encoder: Encoder,
        session: Session,
    ) -> None:
        self._scenario, self._model, self._encoder, self._session = scenario, model, encoder, session
        self._can = recording.port.kind is Kind.CAN
        inputs = recording.json_messages(channels.COMMAND, channels.INJECTED_FAULT)
        effective = [each for each in inputs if _affects_shots(each)]
        waited_ns = recording.origin.get("waited_ns")
        if waited_ns is None:
            self._device = DeviceTimeline(session.constants, initial(session.constants))
        else:
            self._device = waiting_device(session.constants)
            effective = self._apply_before_flight(effective, recording.of_origin("waited_ns", int))
        self._pending = deque(effective)

    @property
    def next_shot(self) -> int | None:
        """First shot that the next pending input affects; None: no input is pending."""
        return self._pending[0].values["first_shot"] if self._pending else None

    def apply_due(self) -> None:
        """Apply all inputs that affect the session's next shot."""
        while (shot := self.next_shot) is not None and shot <= self._session.next_shot:
            self._apply(self._pending.popleft(), 0)

    def _apply_before_flight(self, inputs: list[JsonMessage], waited_ns: int) -> list[JsonMessage]:
        """Apply the inputs up to the command that began the flight, with times from power-up; return the others."""
        # Shot 0 follows the command that began the flight by a lead, in which the host may command later shots.
        before = [each.time_ns < 0 and each.values["first_shot"] == 0 for each in inputs]
        count = 1 + max((k for k, is_before in enumerate(before) if is_before), default=-1)
        for each in inputs[:count]:
            self._apply(each, waited_ns)
        self._session.use_device(self._device.start_flight(self._session.constants, waited_ns))
        return inputs[count:]

    def _apply(self, message: JsonMessage, zero_ns: int) -> None:
        if message.topic == channels.INJECTED_FAULT.topic:
            self._inject(message.values["definition"], is_flying=zero_ns == 0)
            return
        command, tone_ns = message.values, message.values["tone_ns"]
        time_ns = message.time_ns + zero_ns
        tone_ns = time_ns if tone_ns is None else tone_ns
        state, _ = self._device.execute(
            DeviceCommand(command["command"], command["values"], time_ns, tone_ns)
        )
        if state is not None:
            self._session.use_device(state)

    def _inject(self, definition: dict[str, Any], is_flying: bool) -> None:
        fault = read_fault(json.dumps(definition))
        faults = [*self._scenario.faults, fault]
        self._scenario = self._scenario.model_copy(update={"faults": faults})
        faulty = faulty_encoder(self._scenario, self._encoder, self._can)
        events = events_of(faults)
        self._session.use_faults(self._model.with_faults(faults), faulty, events)
        if is_flying:
            self._device.use_events(events)


def _affects_shots(message: JsonMessage) -> bool:
    injected = message.topic == channels.INJECTED_FAULT.topic
    return message.values["first_shot"] is not None and (injected or message.values["verdict"] == "accepted")


class PacketDifference(NamedTuple):
    """A value that differs between the recorded and the recomputed packet."""

    shot: int
    beam: int | None
    """None: a field of the whole packet."""
    field: str
    recorded: Any
    recomputed: Any


def first_difference(
    recorded: OutgoingPacket, recomputed: OutgoingPacket, interface: Interface, can: bool
) -> PacketDifference:
    """First field in which two packets of a shot differ, or the first byte if they cannot be decoded.

    Args:
        recorded: packet of the recording.
        recomputed: packet computed again; differs from `recorded`.
        interface: interface definition of both.
        can: whether the payloads are CAN frame records.
    """
    shot = recorded.shot
    if recorded.due_ns != recomputed.due_ns:
        return PacketDifference(shot, None, "due_ns", recorded.due_ns, recomputed.due_ns)
    if not (recorded.payload and recomputed.payload):
        return PacketDifference(shot, None, "bytes", len(recorded.payload), len(recomputed.payload))
    was, now = (_decoded(packet.payload, interface, can) for packet in (recorded, recomputed))
    if was is not None and now is not None:
        for beam, name, left, right in _fields(was, now):
            if left != right:
                return PacketDifference(shot, beam, name, left, right)
    place = next(
        (k for k, (a, b) in enumerate(zip(recorded.payload, recomputed.payload, strict=False)) if a != b),
        min(len(recorded.payload), len(recomputed.payload)),
    )
    ends = (packet.payload[place : place + 1].hex() or None for packet in (recorded, recomputed))
    return PacketDifference(shot, None, f"byte {place}", *ends)


def _decoded(payload: bytes, interface: Interface, can: bool) -> Message | None:
    if can:
        receiver = CanReceiver(interface)
        received = [m for f in unpack_frames(payload) for m in receiver.receive(f.can_id, f.data, f.is_fd)]
    else:
        received = list(SerialReceiver(interface).receive(payload))
    messages = [message for message in received if isinstance(message, Message)]
    return messages[0] if len(messages) == 1 else None


def _fields(was: Message, now: Message) -> Iterator[tuple[int | None, str, Any, Any]]:
    yield None, "sequence", was.sequence, now.sequence
    yield None, "beams", len(was.beams), len(now.beams)
    for name, value in was.header.items():
        yield None, name, value, now.header.get(name)
    for beam, (left, right) in enumerate(zip(was.beams, now.beams, strict=True)):
        for name, value in left.items():
            yield beam, name, value, right.get(name)


@dataclass
class RecomputeResult:
    """Result of comparing a recording with its recomputation."""

    packets: int = 0
    """Packets in the recording."""
    equal: int = 0
    different: int = 0
    not_compared: int = 0
    """Packets that were never computed, that were sent before the device had processed a command that affects them, or
    whose truth or bytes are missing in a truncated or damaged recording."""
    first: PacketDifference | None = None
    """The first difference."""
    changed: dict[str, tuple[str | None, str | None]] = field(default_factory=dict)
    """Versions, processor and files that have changed: recorded and present value."""

    def to_json(self) -> dict[str, Any]:
        """Values for JSON."""
        return asdict(self) | {"first": None if self.first is None else self.first._asdict()}


def recompute(recording: Recording) -> RecomputeResult:
    """Compute the packets of a recording again and compare them.

    Raises:
        InputError: the recording holds no packets, or a file that the scenario names is missing or cannot be used.
    """
    recorded = recording.packets()
    if not len(recorded):
        raise InputError(str(recording.path), None, Finding("without a packet"), NOT_A_RECORDING)
    result = RecomputeResult(len(recorded), changed=_changed(recording))
    rows = {int(shot): row for row, shot in enumerate(recorded.shot)}
    is_can = recording.port.kind is Kind.CAN
    for computed in _computed(recording, recorded):
        row = rows.get(computed.shot)
        if row is None or recorded.overtaken[row]:
            continue
        # Never computed, or its record is damaged: there is no packet to compare with.
        if not recorded.payload[row] and recorded.status[row] in (DeliveryStatus.LATE, DeliveryStatus.SENT):
            continue
        was = OutgoingPacket(computed.shot, int(recorded.due_ns[row]), recorded.payload[row])
        if (was.due_ns, was.payload) == (computed.due_ns, computed.payload):
            result.equal += 1
            continue
        result.different += 1
        if result.first is None:
            result.first = first_difference(was, computed, recording.interface, is_can)
    recording.warn_of_damage()
    result.not_compared = result.packets - result.equal - result.different
    return result


def _computed(recording: Recording, recorded: Packets) -> Iterator[OutgoingPacket]:
    with _with_recorded_interface(recording) as scenario:
        model, port = build_model(scenario), recording.port
        is_can = port.kind is Kind.CAN
        encoder = Encoder(scenario.wire, is_can, port.fd, model.beam_count)
        faulty = faulty_encoder_of(scenario, encoder, is_can)
        session = Session(model, encoder, faulty=faulty, constants=device_constants_of(scenario, model))
        inputs = RecordedInputs(recording, scenario, model, encoder, session)
        if scenario.live is not None:
            yield from _live(recording, recorded, scenario.live, model, session, inputs)
            return
        end = int(recorded.shot.max()) + 1
        while session.next_shot < end:
            inputs.apply_due()
            until = end if inputs.next_shot is None else min(end, inputs.next_shot)
            block = session.shoot(min(BLOCK_SHOTS, until - session.next_shot))
            if block is None:
                return
            yield from outgoing_packets(block)


def _live(
    recording: Recording,
    recorded: Packets,
    live: Live,
    model: Model,
    session: Session,
    inputs: RecordedInputs,
) -> Iterator[OutgoingPacket]:
    from lidar_emu.trajectory.live import LiveTrajectory

    assert model.flight is not None
    trajectory = model.flight.trajectory
    assert isinstance(trajectory, LiveTrajectory)
    datagrams = (datagram for _, datagram in recording.raw_messages(channels.LIVE_TRUTH))
    truths = enumerate(filter(None, map(Truth.from_bytes, datagrams)), start=1)
    # How many of them each shot knew; None in lockstep, where it knew those that it needs.
    counts: dict[int, int | None] = {
        message.values["shot"]: message.values.get("truth_count")
        for message in recording.json_messages(channels.TRUTH)
    }
    taken, stale_after_ns = 0, round(live.stale_after_s * 1e9)
    for row, shot in enumerate(recorded.shot.tolist()):
        if recorded.status[row] == DeliveryStatus.LATE and not recorded.payload[row]:
            continue
        session.skip_to(shot)
        inputs.apply_due()
        if shot not in counts:
            return
        seen_ns, count = model.flight.seen_ns(shot), counts[shot]
        while (newest := trajectory.newest) is None or (
            newest.time_ns < seen_ns if count is None else taken < count
        ):
            taken, truth = next(truths, (taken, None))
            if truth is None:
                return
            trajectory.take(truth)
        fresh = seen_ns - newest.time_ns <= stale_after_ns
        block = session.shoot(1, fired=fresh or live.when_stale == "coast")
        if block is None:
            return
        yield from outgoing_packets(block)


@contextmanager
def _with_recorded_interface(recording: Recording) -> Iterator[FlightScenario | BenchScenario]:
    """Scenario with the interface definition of the recording, even if the file that it names has changed since."""
    scenario, text = recording.scenario, recording.origin["interface"]
    with tempfile.TemporaryDirectory(prefix="lidar-emu-") as folder:
        if _interface_now(scenario) != text:
            file = Path(folder) / "interface.toml"
            file.write_text(text, encoding="utf-8")
            wire = scenario.wire.model_copy(update={"interface": str(file)})
            scenario = scenario.model_copy(update={"wire": wire})
        yield scenario


def _interface_now(scenario: FlightScenario | BenchScenario) -> str | None:
    try:
        return interface_text(scenario.wire.interface)
    except (InputError, ValueError):
        return None


def _changed(recording: Recording) -> dict[str, tuple[str | None, str | None]]:
    then, now = (
        recording.of_origin("build", mapping_of) | recording.of_origin("files_sha256", mapping_of),
        build() | dict(hashed_files(recording.scenario)),
    )
    names = dict.fromkeys((*then, *now))
    return {name: (then.get(name), now.get(name)) for name in names if then.get(name) != now.get(name)}

"""Recompute a recorded run from its scenario and inputs, and compare it packet by packet."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from lidar_emu.errors import Finding, InputError
from lidar_emu.recording.inputs import RecordedInputs, RecordedTruth
from lidar_emu.recording.mcap_file import NOT_A_RECORDING
from lidar_emu.recording.packet_difference import PacketDifference, first_difference
from lidar_emu.recording.packet_reader import Packets
from lidar_emu.recording.provenance import build, hashed_files, interface_text
from lidar_emu.recording.read import Recording, mapping_of
from lidar_emu.runtime.feed.packet_queue import outgoing_packets
from lidar_emu.runtime.port.packets import DeliveryStatus, OutgoingPacket
from lidar_emu.runtime.prepare import device_constants_of, faulty_encoder_of
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Session
from lidar_emu.shots.model import BLOCK_SHOTS, Model, build_model
from lidar_emu.transports.spec import Kind
from lidar_emu.wire import Encoder


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
        if row is None or recorded.overtaken[row] or _is_missing(recorded, row):
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


def _is_missing(recorded: Packets, row: int) -> bool:
    """Whether there is no packet to compare with: it was never computed, or its record is damaged."""
    return not recorded.payload[row] and recorded.status[row] in (DeliveryStatus.LATE, DeliveryStatus.SENT)


def _is_missed(recorded: Packets, row: int) -> bool:
    return recorded.status[row] == DeliveryStatus.LATE and not recorded.payload[row]


class _Parts(NamedTuple):
    model: Model
    session: Session
    inputs: RecordedInputs


def _computed(recording: Recording, recorded: Packets) -> Iterator[OutgoingPacket]:
    with _with_recorded_interface(recording) as scenario:
        parts = _parts(recording, scenario)
        if scenario.live is not None:
            yield from _live(recording, recorded, scenario, parts)
            return
        session, inputs, end = parts.session, parts.inputs, int(recorded.shot.max()) + 1
        while session.next_shot < end:
            inputs.apply_due()
            until = end if inputs.next_shot is None else min(end, inputs.next_shot)
            block = session.shoot(min(BLOCK_SHOTS, until - session.next_shot))
            if block is None:
                return
            yield from outgoing_packets(block)


def _live(
    recording: Recording, recorded: Packets, scenario: FlightScenario | BenchScenario, parts: _Parts
) -> Iterator[OutgoingPacket]:
    """Compute shot by shot, and skip the shots that were too late to be computed in flight."""
    model, session, live = parts.model, parts.session, scenario.live
    from lidar_emu.trajectory.live import LiveTrajectory

    assert model.flight is not None
    assert isinstance(model.flight.trajectory, LiveTrajectory)
    assert live is not None
    truths = RecordedTruth(recording, model.flight.trajectory)
    stale_after_ns = round(live.stale_after_s * 1e9)
    for row, shot in enumerate(recorded.shot.tolist()):
        if _is_missed(recorded, row):
            continue
        session.skip_to(shot)
        parts.inputs.apply_due()
        seen_ns = model.flight.seen_ns(shot)
        newest_ns = truths.give(shot, seen_ns)
        if newest_ns is None:
            return
        fresh = seen_ns - newest_ns <= stale_after_ns
        block = session.shoot(1, fired=fresh or live.when_stale == "coast")
        if block is None:
            return
        yield from outgoing_packets(block)


def _parts(recording: Recording, scenario: FlightScenario | BenchScenario) -> _Parts:
    model, port = build_model(scenario), recording.port
    is_can = port.kind is Kind.CAN
    encoder = Encoder(scenario.wire, is_can, port.fd, model.beam_count)
    faulty = faulty_encoder_of(scenario, encoder, is_can)
    session = Session(model, encoder, faulty=faulty, constants=device_constants_of(scenario, model))
    return _Parts(model, session, RecordedInputs(recording, scenario, model, encoder, is_can, session))


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

"""A recorded run computed again, from its scenario and what came in, and compared packet by packet."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from lidar_emu.errors import Finding, InputError
from lidar_emu.recording.differences import Difference, first_difference
from lidar_emu.recording.inputs import Changes, LiveTruths
from lidar_emu.recording.mcap_file import ALLOWED
from lidar_emu.recording.provenance import build, hashed_files, interface_text
from lidar_emu.recording.read import Packets, Recording
from lidar_emu.runtime.feed.packet_queue import outgoing
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import Fate, Outgoing
from lidar_emu.runtime.port_faults import packets_on_order
from lidar_emu.runtime.prepare import rules_of
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Session
from lidar_emu.shots.model import BLOCK_SHOTS, Model, build_model
from lidar_emu.transports.spec import Kind
from lidar_emu.wire import Encoder


@dataclass
class Comparison:
    """What came of it."""

    packets: int = 0
    """Of the recording."""
    equal: int = 0
    different: int = 0
    not_compared: int = 0
    """Never computed, or sent before the device knew of a command that their shots follow; and, of a recording that was
    cut short, those whose truth is missing."""
    first: Difference | None = None
    """The first difference."""
    changed: dict[str, tuple[str | None, str | None]] = field(default_factory=dict)
    """What has changed since: versions, processor, files; then and now."""

    def to_json(self) -> dict[str, Any]:
        """As values that JSON knows."""
        return asdict(self) | {"first": None if self.first is None else self.first._asdict()}


def recompute(recording: Recording) -> Comparison:
    """Compute the packets of a recording again and compare them.

    Raises:
        InputError: the recording holds no packets, or a file that the scenario names is gone or cannot be used.
    """
    recorded = recording.packets()
    if not len(recorded):
        raise InputError(str(recording.path), None, Finding("without a packet"), ALLOWED)
    comparison = Comparison(len(recorded), changed=_changed(recording))
    rows = {int(shot): row for row, shot in enumerate(recorded.shot)}
    is_can = recording.port.kind is Kind.CAN
    for computed in _computed(recording, recorded):
        row = rows.get(computed.shot)
        if row is None or recorded.overtaken[row] or _is_missed(recorded, row):
            continue
        was = Outgoing(computed.shot, int(recorded.due_ns[row]), recorded.payload[row])
        if (was.due_ns, was.payload) == (computed.due_ns, computed.payload):
            comparison.equal += 1
            continue
        comparison.different += 1
        if comparison.first is None:
            comparison.first = first_difference(was, computed, recording.interface, is_can)
    comparison.not_compared = comparison.packets - comparison.equal - comparison.different
    return comparison


def _is_missed(recorded: Packets, row: int) -> bool:
    """Whether the shot was too late to be computed."""
    return recorded.fate[row] == Fate.LATE and not recorded.payload[row]


class _Parts(NamedTuple):
    """What computes the shots of a recording."""

    model: Model
    session: Session
    changes: Changes


def _computed(recording: Recording, recorded: Packets) -> Iterator[Outgoing]:
    with _as_it_was(recording) as scenario:
        parts = _parts(recording, scenario)
        if scenario.live is not None:
            yield from _live(recording, recorded, scenario, parts)
            return
        session, changes, end = parts.session, parts.changes, int(recorded.shot.max()) + 1
        while session.next_shot < end:
            changes.follow()
            until = end if changes.next_shot is None else min(end, changes.next_shot)
            block = session.shoot(min(BLOCK_SHOTS, until - session.next_shot))
            if block is None:
                return
            yield from outgoing(block)


def _live(
    recording: Recording, recorded: Packets, scenario: FlightScenario | BenchScenario, parts: _Parts
) -> Iterator[Outgoing]:
    """Shot by shot: those that were too late to be computed are passed over, as they were."""
    model, session, live = parts.model, parts.session, scenario.live
    from lidar_emu.trajectory.live import LiveTrajectory

    assert model.flight is not None
    assert isinstance(model.flight.trajectory, LiveTrajectory)
    assert live is not None
    truths = LiveTruths(recording, model.flight.trajectory)
    stale_after_ns = round(live.stale_after_s * 1e9)
    for row, shot in enumerate(recorded.shot.tolist()):
        if _is_missed(recorded, row):
            continue
        session.pass_over(shot)
        parts.changes.follow()
        seen_ns = model.flight.seen_ns(shot)
        newest_ns = truths.give(shot, seen_ns)
        if newest_ns is None:
            return
        fresh = seen_ns - newest_ns <= stale_after_ns
        block = session.shoot(1, fired=fresh or live.when_stale == "coast")
        if block is None:
            return
        yield from outgoing(block)


def _parts(recording: Recording, scenario: FlightScenario | BenchScenario) -> _Parts:
    model, port = build_model(scenario), recording.port
    is_can = port.kind is Kind.CAN
    encoder = Encoder(scenario.wire, is_can, port.fd, model.beam_count)
    faulty = packets_on_order(scenario, encoder, RunOptions(port))
    session = Session(model, encoder, faulty=faulty, rules=rules_of(scenario, model))
    return _Parts(model, session, Changes(recording, scenario, model, encoder, is_can, session))


@contextmanager
def _as_it_was(recording: Recording) -> Iterator[FlightScenario | BenchScenario]:
    """The scenario with the interface of the recording, whatever has become of the file that it names."""
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
    except (OSError, ValueError):
        return None


def _changed(recording: Recording) -> dict[str, tuple[str | None, str | None]]:
    then, now = (
        json.loads(recording.origin["build"]) | json.loads(recording.origin["files_sha256"]),
        build() | dict(hashed_files(recording.scenario)),
    )
    names = dict.fromkeys((*then, *now))
    return {name: (then.get(name), now.get(name)) for name in names if then.get(name) != now.get(name)}

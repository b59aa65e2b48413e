"""A recording: truth, measurements, packets and their fates in an MCAP file that a cut does not spoil.

Topics (log time: scenario time on the epoch; messages stand in the file one by one, outside of chunks, so that
every reader gets all that was written before a cut):

    /truth         JSON  vehicle position and velocity, true range and closing speed of each beam; with live truth,
                         its age
    /measurement   JSON  the columns of `simulate --out`, one list per column
    /live_truth    bytes a simulator's datagrams as they came, good or not; log time when they came
    /packet        bytes what went onto the wire; on CAN, frame records
    /fault         JSON  a fault that acted on a shot: its place in the scenario's list, its kind, and beams
    /ordered_fault JSON  a fault ordered in flight, as a scenario would state it, and the first shot that has it
    /command       JSON  a command: name, values, sequence, verdict, and the first shot that follows it
    /housekeeping  bytes as /packet, what the device told of itself
    /fate          JSON  due and sent times from the start, and what became of the packet
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from mcap.writer import CompressionType, Writer

from lidar_emu import __version__
from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.runtime.heard import Heard
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.packets import Outgoing, Report
from lidar_emu.scenario.faults import LinkFault, ScheduledFault
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Block

_EARLY = 1000
"""Messages that are kept until the file is begun: of a device that waits for the command to fly."""
_ANY_OBJECT = json.dumps({"type": "object"}).encode()
_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_TRUTH = ("true_range_m", "true_closing_speed_mps")


class Recorder(Observer):
    """An observer of a run that writes everything down.

    The file is begun once the port is open: a run that is refused leaves none, and an older one as it was. If
    it cannot be written any more the flight goes on without it, and `error` says why.

    Args:
        path: of the file.
        scenario: what is flown.
        controlled: whether faults may be ordered in flight.

    Raises:
        InputError: the epoch lies before 1970, where MCAP's times begin.
    """

    def __init__(
        self, path: Path, scenario: FlightScenario | BenchScenario, controlled: bool = False
    ) -> None:
        self._path = path
        self._epoch_ns = (scenario.timing.epoch - _UNIX_EPOCH) // timedelta(microseconds=1) * 1000
        if self._epoch_ns < 0:
            epoch = scenario.timing.epoch.isoformat()
            raise InputError("--record", "timing.epoch", epoch, "allowed in a recording: 1970 and later")
        self._metadata = {
            "version": __version__,
            "seed": str(scenario.seed),
            "scenario": scenario.model_dump_json(),
        }
        self._topics = _JSON_TOPICS + ("/fault",) * bool(scenario.faults or controlled)
        self._topics += ("/ordered_fault",) * controlled
        self._period_ns = scenario.timing.period_ns
        self._writer: Writer | None = None
        self._age_s: dict[int, float] = {}
        self._early: list[tuple[str, int, int, bytes]] = []
        self._file: BinaryIO
        self.error: str | None = None
        """Why the recording is not whole; None if it is."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is None:
            return
        with self._trying():
            self._writer.finish()  # type: ignore[no-untyped-call]
        with self._trying():
            self._file.close()

    def opened(self, port: str, start: datetime) -> None:
        """Begin the file.

        Raises:
            InputError: it cannot be written.
        """
        try:
            self._file = self._path.open("wb")
        except OSError as error:
            why = f"allowed: a file; {error.strerror}"
            raise InputError("--record", None, str(self._path), why) from None
        self._writer = Writer(self._file, use_chunking=False, compression=CompressionType.NONE)
        with self._trying():
            self._begin(self._writer, {**self._metadata, "port": port, "started_utc": start.isoformat()})
            self._file.flush()
        early, self._early = self._early, []
        for message in early:
            self._write(*message)

    def _begin(self, writer: Writer, metadata: dict[str, str]) -> None:
        writer.start(profile="", library=f"lidar-emu {__version__}")
        writer.add_metadata("run", metadata)
        schema = writer.register_schema("any", "jsonschema", _ANY_OBJECT)
        self._channels = {
            **{topic: writer.register_channel(topic, "application/octet-stream", 0) for topic in _RAW_TOPICS},
            **{topic: writer.register_channel(topic, "json", schema) for topic in self._topics},
        }

    def truth_used(self, shot: int, age_ns: int) -> None:
        """Keep it with the truth of the shot."""
        self._age_s[shot] = age_ns * 1e-9

    def commanded(self, heard: Heard, shot: int | None) -> None:
        """Keep the command and its answer."""
        told = heard._asdict() | {"values": dict(heard.values), "first_shot": shot}
        self._write("/command", shot or 0, heard.time_ns, _json(told))

    def kept_house(self, payload: bytes, time_ns: int) -> None:
        """Keep what the device told of itself."""
        self._write("/housekeeping", 0, time_ns, payload)

    def truth(self, datagram: bytes, time_ns: int) -> None:
        """Keep what a simulator sent."""
        self._write("/live_truth", 0, time_ns, datagram)

    def ordered(self, number: int, fault: ScheduledFault | LinkFault, shot: int) -> None:
        """Keep a fault that was ordered in flight, as a scenario would state it."""
        told = {"fault": number, "first_shot": shot, "order": fault.model_dump(mode="json")}
        self._write("/ordered_fault", shot, shot * self._period_ns, _json(told))

    def settled(self, block: Block) -> None:
        """Keep truth and measurements, shot by shot."""
        for k, shot in enumerate(block.measurement.shot.tolist()):
            time_ns = int(block.measurement.time_ns[k].min())
            truth, measured = _truth_and_measurement(block.measurement, k)
            if shot in self._age_s:
                truth["age_s"] = self._age_s.pop(shot)
            self._write("/truth", shot, time_ns, _json(truth))
            self._write("/measurement", shot, time_ns, _json(measured))
        first = int(block.measurement.shot[0])
        for fault in block.faults:
            time_ns = int(block.measurement.time_ns[fault.shot - first].min())
            self._write("/fault", fault.shot, time_ns, _json(fault._asdict() | {"beams": list(fault.beams)}))
        self._flush()

    def report(self, packet: Outgoing, report: Report) -> None:
        """Keep the packet and its fate."""
        fate = {
            "shot": report.shot,
            "due_ns": report.due_ns,
            "sent_ns": report.sent_ns if report.sent_ns >= 0 else None,
            "fate": report.fate.name.lower(),
        }
        if packet.payload:  # it has none where the shot was too late to be computed
            self._write("/packet", packet.shot, packet.due_ns, packet.payload)
        self._write("/fate", packet.shot, packet.due_ns, _json(fate))

    def _write(self, topic: str, shot: int, time_ns: int, data: bytes) -> None:
        if self._writer is None:
            if len(self._early) < _EARLY:
                self._early.append((topic, shot, time_ns, data))
            return
        if self.error is not None:
            return
        instant_ns = max(0, self._epoch_ns + time_ns)  # a command may come before an epoch of 1970
        with self._trying():
            self._writer.add_message(self._channels[topic], instant_ns, data, instant_ns, shot & 0xFFFFFFFF)

    def _flush(self) -> None:
        if self.error is None:
            with self._trying():
                self._file.flush()

    @contextmanager
    def _trying(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.error = self.error or f"{self._path}: the recording is not whole: {error.strerror}"


_RAW_TOPICS = ("/packet", "/live_truth", "/housekeeping")
_JSON_TOPICS = ("/truth", "/measurement", "/command", "/fate")


def _truth_and_measurement(block: Measurement, row: int) -> tuple[dict[str, Any], dict[str, Any]]:
    one = block.one(row)
    columns = {name: values.tolist() for name, values in one.table().items()}
    truth = {
        "shot": int(one.shot[0]),
        "position_site_m": one.position_site_m[0].tolist(),
        "velocity_site_mps": one.velocity_site_mps[0].tolist(),
        **{name: columns.pop(name) for name in _TRUTH},
    }
    return truth, columns


def _json(values: dict[str, Any]) -> bytes:
    """JSON has no NaN: a missing value is null."""
    return json.dumps({name: _plain(value) for name, value in values.items()}).encode()


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

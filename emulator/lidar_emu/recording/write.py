"""Write a recording: truth, measurements, packets and their delivery status, in an MCAP file.

`channels` lists the topics. Messages are written one by one, without chunks, so that a truncated file can be read up
to the last message.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from importlib.resources import files
from importlib.util import find_spec
from io import BufferedWriter, FileIO
from pathlib import Path
from stat import S_ISREG
from types import TracebackType
from typing import Any, Self

import numpy as np
import orjson
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from lidar_emu._version import __version__
from lidar_emu.errors import Finding, InputError
from lidar_emu.files import read_bytes
from lidar_emu.measurement import Measurement
from lidar_emu.recording import channels
from lidar_emu.recording.channels import Channel
from lidar_emu.runtime.change_queue import ReceivedCommand, ReceivedMessage
from lidar_emu.runtime.observer import EventSource, Observer
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket, Pace
from lidar_emu.scenario.faults import LinkFault, ScheduledFault
from lidar_emu.scenario.load import hashed_files
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Block
from lidar_protocol import SHIPPED

_LIBRARIES = ("numpy", "scipy", "numba", "llvmlite")
_CPU = Path("/proc/cpuinfo")
_MOST_INTERFACE_BYTES = 1_000_000


def provenance(scenario: FlightScenario | BenchScenario, options: RunOptions) -> dict[str, str]:
    """Metadata of a recording: values are text or JSON.

    Args:
        scenario: scenario of the run.
        options: options of the run.
    """
    text, interface = scenario.model_dump_json(), interface_text(scenario.wire.interface)
    return {
        "version": __version__,
        "build": json.dumps(build()),
        "seed": str(scenario.seed),
        "scenario": text,
        "scenario_sha256": _sha256(text.encode()),
        "files_sha256": json.dumps(dict(hashed_files(scenario))),
        "interface": interface,
        "interface_sha256": _sha256(interface.encode()),
        "port_options": json.dumps(options.port.to_json()),
        "pace": str(options.pace),
    }


def build() -> dict[str, str]:
    """Versions and processor, on which the bits of a measurement depend besides the scenario."""
    libraries = {name: version(name) for name in _LIBRARIES if find_spec(name)}
    python = f"{platform.python_implementation()} {platform.python_version()}"
    return {"lidar-emu": __version__, "python": python, **libraries, "processor": _processor()}


def interface_text(name: str) -> str:
    """Text of the interface definition that a scenario names."""
    if name in SHIPPED:
        return (files("lidar_protocol") / f"{name}.toml").read_text(encoding="utf-8")
    return read_bytes(Path(name), _MOST_INTERFACE_BYTES, "must be a TOML file").decode("utf-8")


def _processor() -> str:
    try:
        models = [
            line.partition(":")[2].strip() for line in _CPU.read_text().splitlines() if "model name" in line
        ]
    except OSError:
        models = []
    return " ".join((platform.machine(), *models[:1]))


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


_EARLY = 1000
"""Limit on messages kept until the file is opened, from a device that waits for the command to fly."""
_BUFFER_BYTES = 1 << 20
"""More than a part of a block: what others do to the file is looked for before each write."""
_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_EPOCH_NS = 18_429_292_800 * 10**9
"""2554-01-01; 64 bits end in July."""


class Recorder(Observer):
    """Observer of a run that writes a recording.

    The file is created once the port is open, so that a refused run neither creates nor replaces a file. If writing
    fails, the flight continues without a recording, and `error` gives the reason.

    Args:
        path: file to write.
        scenario: scenario of the run.
        options: options of the run.
        open_file: opens the file.

    Raises:
        InputError: the epoch is outside the times of MCAP, 64 bits of nanoseconds since 1970.
    """

    def __init__(
        self,
        path: Path,
        scenario: FlightScenario | BenchScenario,
        options: RunOptions,
        open_file: Callable[[Path], BufferedWriter] | None = None,
    ) -> None:
        self._path, self._open_file = path, open_file or _open_alone
        self._epoch_ns = (scenario.timing.epoch - _UNIX_EPOCH) // timedelta(microseconds=1) * 1000
        if not 0 <= self._epoch_ns < _LAST_EPOCH_NS:
            epoch = scenario.timing.epoch.isoformat()
            raise InputError("--record", "timing.epoch", epoch, "must be from 1970 to 2553 in a recording")
        self._metadata = provenance(scenario, options)
        self._period_ns = scenario.timing.period_ns
        self._writer: Writer | None = None
        self._numbers: dict[str, int] = {}
        self._superseded: list[tuple[int, int]] = []
        self._truth_used: dict[int, dict[str, Any]] = {}
        self._early: list[tuple[Channel, int, bytes, int]] = []
        self._keeps_pace = options.pace is Pace.WALL
        self._between: deque[tuple[Channel, int, bytes]] = deque()
        self._waited_ns = 0
        self._file: BufferedWriter
        self.error: str | None = None
        """Why the recording is incomplete; None if it is complete."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is None:
            return
        if self.error is None:  # what ends with an index counts as complete
            with self._trying():
                self._writer.finish()  # type: ignore[no-untyped-call]
        self._flush()
        with self._trying():
            self._file.close()

    def on_opened(self, port: str, start: datetime) -> None:
        """Create the file.

        Raises:
            InputError: the file cannot be written, or another run is writing it.
        """
        self._file = self._open_file(self._path)
        self._writer = Writer(self._file, use_chunking=False, compression=CompressionType.NONE)
        with self._trying():
            self._begin(self._writer, {**self._metadata, "port": port, "started_utc": start.isoformat()})
        self._flush()
        early, self._early = self._early, []
        for channel, time_ns, data, shot in early:
            self._write(channel, time_ns - self._waited_ns, data, shot)

    def _begin(self, writer: Writer, metadata: dict[str, str]) -> None:
        writer.start(profile="", library=f"lidar-emu {__version__}")
        writer.add_metadata("run", metadata)
        for channel in channels.CHANNELS:
            schema, encoding = 0, "application/octet-stream"
            if channel.fields is not None:
                text = json.dumps(channel.schema()).encode()
                schema, encoding = writer.register_schema(channel.topic, "jsonschema", text), "json"
            number = writer.register_channel(channel.topic, encoding, schema, {"holds": channel.holds})
            self._numbers[channel.topic] = number

    def on_flight_started(self, waited_ns: int) -> None:
        self._waited_ns = waited_ns
        self._metadata["waited_ns"] = str(waited_ns)

    def on_truth(self, datagram: bytes, time_ns: int, counted: bool) -> None:
        self._write(channels.LIVE_TRUTH if counted else channels.REFUSED_TRUTH, time_ns, datagram)

    def on_truth_used(self, shot: int, age_ns: int, truth_count: int) -> None:
        self._truth_used[shot] = {"age_s": age_ns * 1e-9, "truth_count": truth_count}

    def on_command(self, command: ReceivedCommand, shot: int | None) -> None:
        message = command._asdict() | {"values": dict(command.values), "first_shot": shot}
        self._write(channels.COMMAND, message.pop("time_ns"), _json(message), shot or 0)

    def on_host_message(self, message: ReceivedMessage) -> None:
        values = message._asdict() | {"values": dict(message.values)}
        self._write(channels.HOST_MESSAGE, values.pop("time_ns"), _json(values))

    def on_acknowledgement(self, payload: bytes, time_ns: int) -> None:
        self._between.append((channels.ACKNOWLEDGEMENT, time_ns, payload))

    def on_housekeeping(self, payload: bytes, time_ns: int) -> None:
        self._between.append((channels.HOUSEKEEPING, time_ns, payload))

    def on_sent_between(self, time_ns: int | None) -> None:
        channel, made_ns, payload = self._between.popleft()
        if time_ns is not None:
            # As fast as the link takes them, instants of sending are no scenario times.
            self._write(channel, time_ns if self._keeps_pace else made_ns, payload)

    def on_fault_injected(self, number: int, fault: ScheduledFault | LinkFault, shot: int) -> None:
        injected = {"fault": number, "first_shot": shot, "definition": fault.model_dump(mode="json")}
        self._write(channels.INJECTED_FAULT, shot * self._period_ns, _json(injected), shot)

    def on_superseded(self, generation: int, from_shot: int) -> None:
        """Store the generation, to mark packets of older generations that are sent nevertheless."""
        self._superseded.append((generation, from_shot))

    def on_block_sent(self, block: Block) -> None:
        begins_ns = block.measurement.time_ns.min(axis=1).tolist()
        first = int(block.measurement.shot[0])
        truths, measured = _columns(block.measurement)
        for row, time_ns in enumerate(begins_ns):
            shot = first + row
            truth = {name: values[row] for name, values in truths.items()} | self._truth_used.pop(shot, {})
            self._write(channels.TRUTH, time_ns, _json(truth), shot)
            measurement = {name: values[row] for name, values in measured.items()}
            self._write(channels.MEASUREMENT, time_ns, _json(measurement), shot)
        for fault in block.faults:
            occurrence = fault._asdict() | {"beams": list(fault.beams)}
            self._write(channels.FAULT, begins_ns[fault.shot - first], _json(occurrence), fault.shot)
        self._flush()

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:
        # Generations only grow: all later packets follow the commands that this packet follows.
        self._superseded = [mark for mark in self._superseded if mark[0] > packet.generation]
        delivery = {
            "shot": report.shot,
            "due_ns": report.due_ns,
            "sent_ns": report.sent_ns if report.sent_ns >= 0 else None,
            "status": report.status.name.lower(),
            "overtaken": any(packet.shot >= from_shot for _, from_shot in self._superseded),
        }
        if packet.payload:  # empty where the shot was suppressed, or too late to be computed
            self._write(channels.PACKET, packet.due_ns, packet.payload, packet.shot)
        self._write(channels.DELIVERY, packet.due_ns, _json(delivery), packet.shot)

    def on_event(self, source: EventSource, time_ns: int, what: str) -> None:
        self._write(channels.EVENT, time_ns, _json({"of": source, "what": what}))

    def _write(self, channel: Channel, time_ns: int, data: bytes, shot: int = 0) -> None:
        if self._writer is None:
            if len(self._early) < _EARLY:
                self._early.append((channel, time_ns, data, shot))
            return
        if self.error is not None:
            return
        instant_ns = max(0, self._epoch_ns + time_ns)  # a command may come before an epoch of 1970
        with self._trying():
            number = self._numbers[channel.topic]
            self._writer.add_message(number, instant_ns, data, instant_ns, shot & 0xFFFFFFFF)

    def _flush(self) -> None:
        """Write what is buffered, unless another program has deleted or changed the file."""
        if self.error is not None:
            return
        with self._trying():
            state = os.fstat(self._file.fileno())
            is_file = S_ISREG(state.st_mode)
            if is_file and not state.st_nlink:
                self.error = f"{self._path}: the recording was deleted during the run"
            elif is_file and state.st_size != self._file.raw.tell():
                self.error = f"{self._path}: another program changed the recording during the run"
            else:
                self._file.flush()

    @contextmanager
    def _trying(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.error = self.error or f"{self._path}: the recording is incomplete: {error.strerror}"


def _open_alone(path: Path) -> BufferedWriter:
    """Open an empty file that no other run writes until this one closes it; or a pipe or a device.

    Raises:
        InputError: it cannot be written, or another run is writing it.
    """
    try:
        # To append: it is truncated only once it is known that no other run is writing it.
        file: BufferedWriter = BufferedWriter(FileIO(path, "a"), _BUFFER_BYTES)
    except OSError as error:
        found = Finding(f"{path}: {error.strerror}")
        raise InputError("--record", None, found, "must be a writable file") from None
    if S_ISREG(os.fstat(file.fileno()).st_mode):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise InputError("--record", None, str(path), "must be a file that no run is writing") from None
        except OSError:  # a file system without locks: `_flush` finds what others write
            pass
        file.truncate(file.seek(0))
    return file


def _columns(block: Measurement) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    truth = {name: getattr(block, name) for name in ("shot", *channels.TRUE)}
    table = block.table(channels.MEASURED)
    measured = {name: values.reshape(block.fired.shape) for name, values in table.items()}
    measured |= {name: getattr(block, name) for name in channels.OF_SHOT}
    return _contiguous(truth), _contiguous(measured)


def _contiguous(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def _json(values: dict[str, Any]) -> bytes:
    """Serialise with null for NaN, which JSON does not have."""
    return orjson.dumps(values, option=orjson.OPT_SERIALIZE_NUMPY)

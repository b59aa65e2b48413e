"""A recording: truth, measurements, packets and their fates in an MCAP file that a cut does not spoil.

Topics (log time: scenario time on the epoch; messages stand in the file one by one, outside of chunks, so that
every reader gets all that was written before a cut):

    /truth         JSON  vehicle position and velocity, true range and closing speed of each beam
    /measurement   JSON  the columns of `simulate --out`, one list per column
    /packet        bytes what went onto the wire; on CAN, frame records
    /fate          JSON  due and sent times from the start, and what became of the packet
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from mcap.writer import CompressionType, Writer

from lidar_emu import __version__
from lidar_emu.errors import InputError, RunError
from lidar_emu.measurement import Measurement
from lidar_emu.runtime.fly import Observer
from lidar_emu.runtime.packets import Outgoing, Report
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Block
from lidar_emu.transports.spec import PortSpec

_ANY_OBJECT = json.dumps({"type": "object"}).encode()
_TRUTH = ("true_range_m", "true_closing_speed_mps")


class Recorder(Observer):
    """An observer of a run that writes everything down.

    The file is begun once the port is open: a run that is refused leaves none, and an older one as it was.
    """

    def __init__(self, path: Path, scenario: FlightScenario | BenchScenario, port: PortSpec) -> None:
        self._path = path
        self._epoch_ns = round(scenario.timing.epoch.timestamp() * 1e9)
        self._metadata = {
            "version": __version__,
            "seed": str(scenario.seed),
            "port": str(port),
            "scenario": scenario.model_dump_json(),
        }
        self._begun = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._begun:
            with self._file:
                self._writer.finish()  # type: ignore[no-untyped-call]

    def opened(self, port: str) -> None:  # noqa: ARG002
        """Begin the file.

        Raises:
            InputError: it cannot be written.
        """
        try:
            self._file: BinaryIO = self._path.open("wb")
        except OSError as error:
            raise InputError(
                "--record", None, str(self._path), f"allowed: a file; {error.strerror}"
            ) from None
        self._writer = Writer(self._file, use_chunking=False, compression=CompressionType.NONE)
        self._begun = True
        self._writer.start(profile="", library=f"lidar-emu {__version__}")
        self._writer.add_metadata("run", self._metadata)
        schema = self._writer.register_schema("any", "jsonschema", _ANY_OBJECT)
        self._channels = {
            "/packet": self._writer.register_channel("/packet", "application/octet-stream", 0),
            **{topic: self._writer.register_channel(topic, "json", schema) for topic in _JSON_TOPICS},
        }
        self._flush()

    def computed(self, block: Block) -> None:
        """Keep truth and measurements, shot by shot."""
        for k, shot in enumerate(block.measurement.shot.tolist()):
            time_ns = int(block.measurement.time_ns[k, 0])
            truth, measured = _truth_and_measurement(block.measurement, k)
            self._write("/truth", shot, time_ns, _json(truth))
            self._write("/measurement", shot, time_ns, _json(measured))
        self._flush()

    def report(self, packet: Outgoing, report: Report) -> None:
        """Keep the packet and its fate."""
        fate = {
            "shot": report.shot,
            "due_ns": report.due_ns,
            "sent_ns": report.sent_ns if report.sent_ns >= 0 else None,
            "fate": report.fate.name.lower(),
        }
        self._write("/packet", packet.shot, packet.due_ns, packet.payload)
        self._write("/fate", packet.shot, packet.due_ns, _json(fate))

    def _write(self, topic: str, shot: int, time_ns: int, data: bytes) -> None:
        instant_ns = self._epoch_ns + time_ns
        try:
            self._writer.add_message(self._channels[topic], instant_ns, data, instant_ns, shot & 0xFFFFFFFF)
        except OSError as error:
            raise RunError(f"{self._path}: {error.strerror}") from None

    def _flush(self) -> None:
        try:
            self._file.flush()
        except OSError as error:
            raise RunError(f"{self._path}: {error.strerror}") from None


_JSON_TOPICS = ("/truth", "/measurement", "/fate")


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

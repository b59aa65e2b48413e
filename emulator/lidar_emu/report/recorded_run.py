"""The contents of a recording, read once for all parts of a report."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.recording import channels
from lidar_emu.recording.read import JsonMessage, Packets, Recording
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus
from lidar_emu.runtime.summary import Tally


@dataclass(frozen=True)
class RecordedRun:
    """The contents of a recording."""

    recording: Recording
    measurement: Measurement
    packets: Packets
    faults: list[JsonMessage]
    """Occurrences of faults, one per shot and fault."""
    injected_faults: list[JsonMessage]
    """Faults injected in flight."""
    commands: list[JsonMessage]
    events: list[JsonMessage]
    """Events of the link and of the run's processes."""
    housekeeping_packets: int
    """Number of housekeeping packets."""

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.recording.scenario.name

    @property
    def keeps_time(self) -> bool:
        """Whether packets had deadlines: at pace `max` and in lockstep no packet is late."""
        return self.recording.origin.get("pace") == Pace.WALL

    @property
    def is_flight(self) -> bool:
        """Whether the run was a flight: a bench pattern has no positions."""
        return bool(np.isfinite(self.measurement.position_site_m).any())

    @property
    def lateness_us(self) -> FloatArray:
        """(packets,) Time from due to written of each packet sent."""
        sent = self.packets.status == DeliveryStatus.SENT
        late_us: FloatArray = np.maximum(self.packets.sent_ns - self.packets.due_ns, 0)[sent] / 1e3
        return late_us

    def tally(self) -> Tally:
        """Compute the counts of the summary, which a killed run could not write."""
        tally = Tally(Pace.WALL if self.keeps_time else Pace.MAX)
        tally.add_measurement(self.measurement)
        packets, silent = self.packets, self._silent()
        columns = (packets.shot, packets.due_ns, packets.sent_ns, packets.status, silent)
        for shot, due_ns, sent_ns, status, is_silent in zip(*(c.tolist() for c in columns), strict=True):
            tally.add_report(DeliveryReport(shot, due_ns, sent_ns, DeliveryStatus(status)), is_silent)
        tally.faults = Counter(fault.values["kind"] for fault in self.faults)
        return tally

    def _silent(self) -> BoolArray:
        """(packets,) Whether the device fired no beam of the packet's shot."""
        fires = dict(zip(self.measurement.shot.tolist(), self._fires().tolist(), strict=True))
        return np.array([not fires.get(shot, True) for shot in self.packets.shot.tolist()], dtype=np.bool_)

    def _fires(self) -> BoolArray:
        return np.asarray(self.measurement.fired.any(axis=1))

    def contents(self) -> dict[str, Any]:
        """Summarise the recording as JSON values; keys that the summary file also has carry the same values."""
        recording, scenario, origin = self.recording, self.recording.scenario, self.recording.origin
        time_s = self.measurement.time_ns * 1e-9
        return {
            "file": str(recording.path),
            "size_bytes": recording.path.stat().st_size,
            "is_whole": recording.is_whole,
            "damage": recording.damage.to_json(),
            "scenario": scenario.name,
            "seed": scenario.seed,
            "level": None if not self.is_flight else getattr(scenario, "level", None),
            "rate_hz": scenario.timing.rate_hz,
            "beam_count": self.measurement.beam_count,
            "from_s": float(time_s.min()),
            "until_s": float(time_s.max()),
            "started_utc": recording.started_utc.isoformat(),
            "port": origin["port"],
            "pace": origin["pace"],
            "version": origin["version"],
            **self.tally().to_json(),
            "measured": len(self.measurement),
            "housekeeping_packets": self.housekeeping_packets,
            "commanded": [_row(message) for message in self.commands],
            "injected": [_row(message) for message in self.injected_faults],
            "events": [_row(message) for message in self.events],
        }


def read_recorded_run(recording: Recording) -> RecordedRun:
    """Read everything in a recording.

    Raises:
        InputError: the recording has no shots.
    """
    measurement, packets = recording.measurement(), recording.packets()
    messages = recording.json_messages(
        channels.FAULT, channels.INJECTED_FAULT, channels.COMMAND, channels.EVENT
    )
    housekeeping = recording.raw_messages(channels.HOUSEKEEPING)
    recording.warn_of_damage()
    by_topic: dict[str, list[JsonMessage]] = {}
    for message in messages:
        by_topic.setdefault(message.topic, []).append(message)
    return RecordedRun(
        recording,
        measurement,
        packets,
        faults=by_topic.get(channels.FAULT.topic, []),
        injected_faults=by_topic.get(channels.INJECTED_FAULT.topic, []),
        commands=by_topic.get(channels.COMMAND.topic, []),
        events=by_topic.get(channels.EVENT.topic, []),
        housekeeping_packets=len(housekeeping),
    )


def _row(message: JsonMessage) -> dict[str, Any]:
    return {"time_s": message.time_ns * 1e-9, **message.values}

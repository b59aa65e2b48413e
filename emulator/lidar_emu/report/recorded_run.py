"""The contents of a recording, read once for all pages of a report."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.recording import channels
from lidar_emu.recording.read import JsonMessage, Packets, Recording
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus
from lidar_emu.runtime.summary import Tally


@dataclass(frozen=True)
class RecordedRun:
    """A recording, read."""

    recording: Recording
    measurement: Measurement
    packets: Packets
    faults: list[JsonMessage]
    """One for each shot and fault that acted."""
    ordered: list[JsonMessage]
    """Faults that were ordered in flight."""
    commands: list[JsonMessage]
    events: list[JsonMessage]
    """Of the link and of the run's processes."""
    said: int
    """How often the device told of itself, between the shots."""

    @property
    def name(self) -> str:
        """Of the scenario."""
        return self.recording.scenario.name

    @property
    def keeps_time(self) -> bool:
        """Whether packets had instants to keep: at pace `max` and in lockstep nothing is late."""
        return self.recording.origin.get("pace") == Pace.WALL

    @property
    def is_flight(self) -> bool:
        """Whether something flew: a bench pattern knows of no place."""
        return bool(np.isfinite(self.measurement.position_site_m).any())

    @property
    def lateness_us(self) -> FloatArray:
        """(packets,) Of those that were sent, from due to written."""
        sent = self.packets.status == DeliveryStatus.SENT
        late_us: FloatArray = np.maximum(self.packets.sent_ns - self.packets.due_ns, 0)[sent] / 1e3
        return late_us

    def tally(self) -> Tally:
        """The counts of the summary, also of a run that was killed before it could tell them."""
        tally = Tally(Pace.WALL if self.keeps_time else Pace.MAX)
        tally.measured(self.measurement)
        packets, silent = self.packets, self._silent()
        columns = (packets.shot, packets.due_ns, packets.sent_ns, packets.status, silent)
        for shot, due_ns, sent_ns, status, is_silent in zip(*(c.tolist() for c in columns), strict=True):
            tally.report(DeliveryReport(shot, due_ns, sent_ns, DeliveryStatus(status)), is_silent)
        tally.faults = Counter(fault.values["kind"] for fault in self.faults)
        return tally

    def _silent(self) -> BoolArray:
        """(packets,) Whether the device fired no beam of the packet's shot."""
        fires = dict(zip(self.measurement.shot.tolist(), self._fires().tolist(), strict=True))
        return np.array([not fires.get(shot, True) for shot in self.packets.shot.tolist()], dtype=np.bool_)

    def _fires(self) -> BoolArray:
        return np.asarray(self.measurement.fired.any(axis=1))

    def contents(self) -> dict[str, Any]:
        """What is in the file, under the names of the summary file and a few of its own."""
        recording, scenario, origin = self.recording, self.recording.scenario, self.recording.origin
        time_s = self.measurement.time_ns * 1e-9
        return {
            "file": str(recording.path),
            "size_bytes": recording.path.stat().st_size,
            "is_whole": recording.is_whole,
            "scenario": scenario.name,
            "seed": scenario.seed,
            "level": None if not self.is_flight else getattr(scenario, "level", None),
            "rate_hz": scenario.timing.rate_hz,
            "beam_count": self.measurement.beam_count,
            "from_s": float(time_s.min()),
            "until_s": float(time_s.max()),
            "started_utc": origin["started_utc"],
            "port": origin["port"],
            "pace": origin["pace"],
            "version": origin["version"],
            **self.tally().to_json(),
            "measured": len(self.measurement),
            "said": self.said,
            "commanded": [_row(told) for told in self.commands],
            "ordered": [_row(told) for told in self.ordered],
            "events": [_row(told) for told in self.events],
        }


def read_recorded_run(recording: Recording) -> RecordedRun:
    """Everything in a recording.

    Raises:
        InputError: no shot was recorded, or a message cannot be read.
    """
    try:
        measurement, packets = recording.measurement(), recording.packets()
        told = recording.json_messages(
            channels.FAULT, channels.INJECTED_FAULT, channels.COMMAND, channels.EVENT
        )
    except KeyError as error:
        found = Finding(f"a message without {error}, of another version of lidar-emu")
        raise InputError(str(recording.path), None, found, "allowed: one of this version") from None
    of: dict[str, list[JsonMessage]] = {}
    for each in told:
        of.setdefault(each.topic, []).append(each)
    faults, ordered, commands, events = (
        of.get(channel.topic, [])
        for channel in (channels.FAULT, channels.INJECTED_FAULT, channels.COMMAND, channels.EVENT)
    )
    said = len(recording.raw_messages(channels.HOUSEKEEPING))
    return RecordedRun(recording, measurement, packets, faults, ordered, commands, events, said)


def _row(told: JsonMessage) -> dict[str, Any]:
    return {"time_s": told.time_ns * 1e-9, **told.values}

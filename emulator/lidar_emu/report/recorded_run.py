"""The contents of a recording, read once for all parts of a report."""

from __future__ import annotations

from array import array
from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.recording import channels
from lidar_emu.recording.channels import JsonMessage, JsonReader, checked_values
from lidar_emu.recording.mcap_file import Damage, ReadPosition, RecordedMessage
from lidar_emu.recording.read import Recording
from lidar_emu.recording.readers import Deliveries, DeliveryReader, ShotReader
from lidar_emu.report.plot_style import GRID, INK, Limits, error_limits
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, Pace
from lidar_emu.runtime.summary import Tally

if TYPE_CHECKING:
    from matplotlib.axes import Axes


REPORTED = frozenset(
    {
        "shot", "time_ns", "due_ns", "fired", "reason", "range_m", "closing_speed_mps", "range_valid", "speed_valid",
        "sigma_range_m", "sigma_speed_mps", "snr_db", "point_site_m", "true_range_m", "true_closing_speed_mps",
        "true_in_gap", "true_peak_source", "true_point_site_m", "position_site_m", "velocity_site_mps",
        "site_from_body", "pattern", "beam_angle_deg",
    }
)  # fmt: skip
"""Columns that the table and the figures of a report show."""
_BLOCK_ROWS = 1 << 16


@dataclass(frozen=True)
class RecordedRun:
    """The contents of a recording."""

    recording: Recording
    measurement: Measurement
    deliveries: Deliveries
    faults_ns: dict[str, IntArray]
    """Scenario times of the shots on which faults acted, by the kind of fault, one for each fault."""
    injected_faults: list[JsonMessage]
    """Faults injected in flight."""
    commands: list[JsonMessage]
    events: list[JsonMessage]
    """Events of the link and of the run's processes."""
    housekeeping_packets: int
    """Number of housekeeping packets."""

    @property
    def name(self) -> str:
        return self.recording.scenario.name

    @property
    def keeps_time(self) -> bool:
        """Whether packets were to be sent when due: not at pace `max`, in lockstep, or where the host polls."""
        return self.recording.origin.get("pace") == Pace.WALL and not self.is_polled

    @property
    def is_polled(self) -> bool:
        """Whether packets waited for the host."""
        return self.recording.scenario.wire.polled

    @property
    def is_flight(self) -> bool:
        """Whether the run was a flight: a bench pattern has no positions."""
        return bool(np.isfinite(self.measurement.position_site_m).any())

    @property
    def lateness_us(self) -> FloatArray:
        """(packets,) Time from due to written of each packet sent."""
        sent = self.deliveries.status == DeliveryStatus.SENT
        late_us: FloatArray = np.maximum(self.deliveries.sent_ns - self.deliveries.due_ns, 0)[sent] / 1e3
        return late_us

    def tally(self) -> Tally:
        """Compute the counts of the summary, which a killed run could not write."""
        tally = Tally(Pace.WALL if self.keeps_time else Pace.MAX)
        tally.add_measurement(self.measurement)
        found = self.deliveries
        silent = np.isin(found.shot, self.measurement.shot[~self.measurement.fired.any(axis=1)])
        columns = (found.shot, found.due_ns, found.sent_ns, found.status, silent)
        for first in range(0, len(found), _BLOCK_ROWS):
            rows = (column[first : first + _BLOCK_ROWS].tolist() for column in columns)
            for shot, due_ns, sent_ns, status, is_silent in zip(*rows, strict=True):
                tally.add_report(DeliveryReport(shot, due_ns, sent_ns, DeliveryStatus(status)), is_silent)
        tally.faults.update({kind: len(times_ns) for kind, times_ns in self.faults_ns.items()})
        return tally

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


class RunReader:
    """Reader of a recording that may still be written, part by part.

    Args:
        recording: the recording.
        columns: names of the measurement's columns to read, with all of `REPORTED`.
    """

    def __init__(self, recording: Recording, columns: Collection[str] = REPORTED) -> None:
        self._recording = recording
        self._since = ReadPosition()
        self._no_shots: Measurement | None = None
        self.shots = ShotReader(recording.damage, columns)
        self._begin_part()

    def next_part(self) -> RecordedRun | None:
        """What was added since the last part; None until there is a shot."""
        recording, injected, commands, events = self._recording, self._injected, self._commands, self._events
        others = self._deliveries, self._faults, self._housekeeping, injected, commands, events
        recording.read(self.shots, *others, since=self._since)
        measurement = self.shots.take() or self._no_shots
        if measurement is None:
            return None
        self._no_shots = measurement.part(0, 0)
        part = RecordedRun(
            recording,
            measurement,
            self._deliveries.deliveries(),
            {kind: np.array(times_ns) for kind, times_ns in self._faults.times_ns.items()},
            injected.messages,
            commands.messages,
            events.messages,
            self._housekeeping.count,
        )
        self._begin_part()
        return part

    def _begin_part(self) -> None:
        damage, epoch_ns = self._recording.damage, self._recording.epoch_ns
        self._deliveries = DeliveryReader(damage)
        self._faults = _FaultReader(damage, epoch_ns)
        self._housekeeping = _Counter(channels.HOUSEKEEPING.topic)
        self._injected, self._commands, self._events = (
            JsonReader(damage, epoch_ns, (channel,))
            for channel in (channels.INJECTED_FAULT, channels.COMMAND, channels.EVENT)
        )


def read_recorded_run(recording: Recording, columns: Collection[str] = REPORTED) -> RecordedRun:
    """Read a recording, in one pass.

    Args:
        recording: the recording.
        columns: names of the measurement's columns to read, with all of `REPORTED`.

    Raises:
        InputError: the recording has no shots.
    """
    reader = RunReader(recording, columns)
    run = reader.next_part()
    if run is None:
        raise reader.shots.missing(str(recording.path))
    recording.warn_of_damage()
    return run


class _FaultReader:
    topics = (channels.FAULT.topic,)

    def __init__(self, damage: Damage, epoch_ns: int) -> None:
        self._damage = damage
        self._epoch_ns = epoch_ns
        self.times_ns: dict[str, array[int]] = {}

    def add(self, message: RecordedMessage) -> None:
        values = checked_values(message, channels.FAULT, self._damage)
        if values is not None:
            self.times_ns.setdefault(values["kind"], array("q")).append(message.log_time_ns - self._epoch_ns)


class _Counter:
    def __init__(self, topic: str) -> None:
        self.topics = (topic,)
        self.count = 0

    def add(self, _: RecordedMessage) -> None:
        self.count += 1


def _row(message: JsonMessage) -> dict[str, Any]:
    return {"time_s": message.time_ns * 1e-9, **message.values}


_BAND_POINTS, _LEAST_IN_INTERVAL = 240, 64
_LEAST_RANGE_ERROR_M, _LEAST_SPEED_ERROR_MMPS = 0.01, 0.1
"""Least half width of the axes of errors: errors of a receiver without any are rounding."""


class ErrorValues(NamedTuple):
    """Errors of one quantity, arrays of (shots, beams) in `unit`."""

    quantity: str
    unit: str
    error: FloatArray
    sigma: FloatArray
    """Stated standard deviation; NaN where none is stated."""
    valid: BoolArray
    least: float
    """Least half width of the axis."""

    @property
    def label(self) -> str:
        return f"{self.quantity} error ({self.unit})"

    def limits(self) -> Limits:
        """Compute the limits of the axis, which contain two stated sigma."""
        stated = self.sigma[self.valid & np.isfinite(self.sigma)]
        band = 2.0 * float(np.median(stated)) if stated.size else 0.0
        return error_limits(self.error[self.valid], max(band, self.least))

    def outside(self) -> int:
        """Count the errors beyond the limits."""
        error = self.error[self.valid]
        return int(np.count_nonzero(np.isfinite(error) & ~self.limits().contain(error)))


def error_values(measurement: Measurement) -> tuple[ErrorValues, ErrorValues]:
    """Compute the errors of range in m and of closing speed in mm/s."""
    error_m = measurement.range_m - measurement.true_range_m
    error_mmps = 1e3 * (measurement.closing_speed_mps - measurement.true_closing_speed_mps)
    sigma_m, sigma_mmps = measurement.sigma_range_m, 1e3 * measurement.sigma_speed_mps
    return (
        ErrorValues("range", "m", error_m, sigma_m, measurement.range_valid, _LEAST_RANGE_ERROR_M),
        ErrorValues(
            "speed", "mm/s", error_mmps, sigma_mmps, measurement.speed_valid, _LEAST_SPEED_ERROR_MMPS
        ),
    )


def add_sigma_band(axes: Axes, time_s: FloatArray, sigma: FloatArray) -> None:
    """Draw twice the median of the stated sigma, interval by interval; nothing if none is stated."""
    stated: BoolArray = np.isfinite(sigma) & (sigma > 0.0)
    if not stated.any():
        return
    time_s, sigma = time_s[stated], sigma[stated]
    order = np.argsort(time_s, kind="stable")
    parts = np.array_split(order, min(_BAND_POINTS, len(order), max(len(order) // _LEAST_IN_INTERVAL, 40)))
    middle_s = np.array([np.median(time_s[part]) for part in parts])
    middle_s[[0, -1]] = time_s[order[[0, -1]]]
    twice = 2.0 * np.array([np.median(sigma[part]) for part in parts])
    axes.fill_between(
        middle_s, -twice, twice, color=GRID, alpha=0.3, linewidth=0, label="±2σ as stated", zorder=0
    )
    axes.plot(middle_s, np.stack([-twice, twice], axis=1), color=INK, linewidth=0.9, zorder=2.5)

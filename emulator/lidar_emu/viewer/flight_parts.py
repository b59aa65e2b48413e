"""A recording part by part, as viewers show it: a finished one is one part, one that is being written gains parts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.ground_below import Extent, extent_of
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.viewer.events import Event, EventFinder
from lidar_emu.viewer.ground_mesh import GroundMesh, flight_of, ground_mesh

if TYPE_CHECKING:
    from lidar_emu.flight.flight import Flight

Span = tuple[float, float]
"""Least and greatest value."""

_ROOM = 0.5
"""Share of its size by which a box grows beyond the flight: each new ground takes some time."""
_PATH_POINTS = 5000
_PATH_EVERY_NS = 1_000_000_000
_PLANNED_POINTS = 200


@dataclass(frozen=True)
class FlightPart:
    """What a recording has gained."""

    run: RecordedRun
    """Shots, deliveries and messages of this part."""
    events: list[Event]
    range_span_m: Span
    """Span of the valid ranges so far."""
    speed_span_mps: Span
    """Span of the valid speeds so far, without their signs."""
    path_site_m: FloatArray | None = None
    """(n, 3) All positions so far, thinned where they are many; None: not renewed, or not a flight."""
    extent: Extent | None = None
    """Box around the flight; None: as before, or not a flight."""
    ground: GroundMesh | None = None
    """The ground in that box; None: as before, or unknown."""


class FlightParts:
    """Parts of one recording, in order.

    Args:
        notes: takes what cannot be shown, with the reasons.
        is_running: whether more parts will follow, so that the box holds the flight that is planned, too.
    """

    def __init__(self, notes: list[str], is_running: bool) -> None:
        self._notes, self._is_running = notes, is_running
        self._events = EventFinder()
        self._range_span_m: Span = (np.inf, -np.inf)
        self._speed_span_mps: Span = (np.inf, -np.inf)
        self._positions_m: list[FloatArray] = []
        self._path_due_ns = 0
        self._extent: Extent | None = None
        self._flight: Flight | None = None
        self._is_first = True

    def part(self, run: RecordedRun) -> FlightPart:
        """Build the next part.

        Args:
            run: what the recording has gained since the part before.
        """
        measured = run.measurement
        self._range_span_m = _joined(self._range_span_m, measured.range_m[measured.range_valid])
        speed_mps = np.abs(measured.closing_speed_mps[measured.speed_valid])
        self._speed_span_mps = _joined(self._speed_span_mps, speed_mps)
        part = FlightPart(run, self._events.next_events(run), self._range_span_m, self._speed_span_mps)
        if self._is_first and not run.is_flight:
            self._notes.append("no flight to show: a bench pattern has no positions")
        self._is_first = False
        if not run.is_flight:
            return part
        extent = self._grown(run)
        return replace(part, path_site_m=self._path(measured), extent=extent, ground=self._ground(extent))

    def _path(self, measured: Measurement) -> FloatArray | None:
        self._positions_m.append(measured.position_site_m)
        last_ns = int(measured.time_ns[-1, 0])
        if last_ns < self._path_due_ns:
            return None
        self._path_due_ns = last_ns + _PATH_EVERY_NS
        self._positions_m = [np.concatenate(self._positions_m)]
        every = -(-len(self._positions_m[0]) // _PATH_POINTS)
        return self._positions_m[0][::every]

    def _grown(self, run: RecordedRun) -> Extent | None:
        """The box where this part is outside the last one."""
        seen = extent_of(run.measurement)
        if self._extent is None:
            self._flight = flight_of(run, self._notes)
            self._extent = _around(seen, self._planned()) if self._is_running else seen
            return self._extent
        if self._extent.contains(seen):
            return None
        size_m = self._extent.high_m - self._extent.low_m
        both = _around(self._extent, seen)
        low_m = np.where(seen.low_m < self._extent.low_m, both.low_m - _ROOM * size_m, both.low_m)
        high_m = np.where(seen.high_m > self._extent.high_m, both.high_m + _ROOM * size_m, both.high_m)
        self._extent = Extent(low_m, high_m)
        return self._extent

    def _planned(self) -> Extent:
        """The box around the planned path; an empty one of a flight that is not planned."""
        flight = self._flight
        if flight is None or flight.is_live:
            return Extent(np.full(3, np.inf), np.full(3, -np.inf))
        time_s = np.linspace(0.0, 1e-9 * (flight.shot_count - 1) * flight.period_ns, _PLANNED_POINTS)
        position_m = flight.trajectory.state(time_s).position_site_m
        return Extent(position_m.min(axis=0), position_m.max(axis=0))

    def _ground(self, extent: Extent | None) -> GroundMesh | None:
        if extent is None or self._flight is None:
            return None
        return ground_mesh(self._flight.scene, extent)


def _joined(span: Span, values: FloatArray) -> Span:
    if not values.size:
        return span
    return min(span[0], float(values.min())), max(span[1], float(values.max()))


def _around(one: Extent, other: Extent) -> Extent:
    return Extent(np.minimum(one.low_m, other.low_m), np.maximum(one.high_m, other.high_m))

"""A recording part by part, as viewers show it: a finished one is one part, one that is being written gains parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.receiver.returns import Reason
from lidar_emu.recording.read import Recording
from lidar_emu.report.ground_survey import Extent, extent_of, hill_shade, level_parts, sample_ground
from lidar_emu.report.recorded_run import RecordedRun, RunReader
from lidar_emu.runtime.clock import Clock
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model

if TYPE_CHECKING:
    from lidar_emu.beams.flight import Flight
    from lidar_emu.scene.ray_hits import Scene

_LONG_AGO_NS = np.iinfo(np.int64).min // 2


class Event(NamedTuple):
    """A line."""

    time_ns: int
    """Scenario time."""
    level: str
    """INFO, WARN or ERROR."""
    text: str


def _messages(run: RecordedRun) -> Iterator[Event]:
    for level, what, messages in (
        ("ERROR", "injected", run.injected_faults),
        ("INFO", "command", run.commands),
        ("INFO", "event", run.events),
    ):
        for message in messages:
            values = (f"{name} {each}" for name, each in message.values.items() if each not in (None, {}))
            yield Event(message.time_ns, level, f"{what}: {', '.join(values)}")


SAMPLES = 250
"""Vertices of the ground along each axis: a browser without a graphics processor turns them smoothly."""
_TEXELS = 800
"""Samples of the shading along each axis."""
_WIDER = 1.15
"""The ground is wider than the flight by this factor."""
_EDGE_SHARE, _LEVEL_SHARE = 0.08, 0.03
"""Widths over which the ground fades: at its edges, and where level ground adjoins relief."""
_LEAST_LEVEL = 0.2


class GroundMesh(NamedTuple):
    """Triangles over a square grid, and their shading."""

    vertices_m: FloatArray
    """(vertices, 3)"""
    triangles: IntArray
    """(triangles, 3) Vertices of each."""
    grey: NDArray[np.uint8]
    """(vertices,)"""
    texture_points: FloatArray
    """(vertices, 2) Where each vertex is in the texture, from its first row and column, as shares."""
    texture: FloatArray
    """(rows, columns) Brightness, 0 to 1: hill shade, faded at the edges and where the relief ends."""


def ground_mesh(scene: Scene, extent: Extent) -> GroundMesh:
    """Sample the ground within an extent, and somewhat beyond."""
    wide = extent.with_ground(_WIDER)
    ground_m, fine_m = sample_ground(scene, wide, SAMPLES), sample_ground(scene, wide, _TEXELS + 1)
    grey = np.full(ground_m.shape[:2], 153, dtype=np.uint8)
    grey[:-1, :-1] = 255 * hill_shade(ground_m)
    share = np.linspace(0.0, 1.0, SAMPLES)
    texture_points = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
    triangles = ground_triangles(np.isfinite(ground_m[..., 2]))
    texture = hill_shade(fine_m) * _fade(level_parts(fine_m[..., 2]))
    return GroundMesh(
        np.nan_to_num(ground_m.reshape(-1, 3)), triangles, grey.ravel(), texture_points, texture
    )


def _fade(level: BoolArray) -> FloatArray:
    """(n, n) Factor on the brightness: 0 at the edges, and less far from the relief, if there is any."""
    from scipy.ndimage import distance_transform_edt

    samples = len(level)
    from_edge = np.minimum(np.arange(samples), np.arange(samples)[::-1]) / (_EDGE_SHARE * samples)
    edge = np.clip(from_edge, 0.0, 1.0)
    fade = np.minimum(edge[:, None], edge)
    if level.any() and not level.all():
        away = distance_transform_edt(level) / (_LEVEL_SHARE * samples)
        fade *= _LEAST_LEVEL + (1.0 - _LEAST_LEVEL) * np.exp(-away)
    return np.asarray(fade)


def ground_triangles(known: BoolArray) -> IntArray:
    """(triangles, 3) Vertices of two triangles for each square of a grid whose four corners are known."""
    rows, columns = known.shape
    vertex = np.arange(rows * columns).reshape(rows, columns)
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    south_west, south_east = vertex[:-1, :-1][whole], vertex[:-1, 1:][whole]
    north_west, north_east = vertex[1:, :-1][whole], vertex[1:, 1:][whole]
    lower = np.stack([south_west, south_east, north_east], axis=1)
    upper = np.stack([south_west, north_east, north_west], axis=1)
    return np.concatenate([lower, upper]).astype(np.int64)


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
    time_span_s: Span | None = None
    """From the start of the flight to its end, or to the planned one while it is flown; None: unknown."""
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
        self._was_valid: BoolArray | bool = True
        self._acted_ns: dict[str, int] = {}
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
        # Beams that are lost and found, faults, commands, and events of the link and of the processes, in order.
        events = sorted([*self._lost_beams(measured), *self._faults(run), *_messages(run)])
        part = FlightPart(run, events, self._time_span(measured))
        if self._is_first and not run.is_flight:
            self._notes.append("no flight to show: a bench pattern has no positions")
        self._is_first = False
        if not run.is_flight:
            return part
        extent = self._grown(run)
        ground = None
        if extent is not None and self._flight is not None:
            ground = ground_mesh(self._flight.scene, extent)
        time_span_s, path_site_m = self._time_span(measured), self._path(measured)
        return replace(part, time_span_s=time_span_s, path_site_m=path_site_m, extent=extent, ground=ground)

    def _time_span(self, measured: Measurement) -> Span | None:
        if not self._is_running:
            return float(measured.time_ns.min()) * 1e-9, float(measured.time_ns.max()) * 1e-9
        flight = self._flight
        return (
            None if flight is None or flight.is_live else (0.0, 1e-9 * flight.shot_count * flight.period_ns)
        )

    def _lost_beams(self, measured: Measurement) -> Iterator[Event]:
        before = np.broadcast_to(self._was_valid, (1, measured.beam_count))
        valid = np.concatenate([before, measured.range_valid])
        self._was_valid = valid[-1]
        for shot, beam in np.argwhere(np.diff(valid, axis=0)).tolist():
            time_ns = int(measured.time_ns[shot, beam])
            if measured.range_valid[shot, beam]:
                yield Event(time_ns, "INFO", f"beam {beam}: valid")
            else:
                reason = Reason(measured.reason[shot, beam]).name.lower()
                yield Event(time_ns, "WARN", f"beam {beam}: {reason}")

    def _faults(self, run: RecordedRun) -> Iterator[Event]:
        """The first shot of each time that a fault acts: shots that follow one another are one time."""
        apart_ns = 1.5e9 / run.recording.scenario.timing.rate_hz
        for kind, times_ns in run.faults_ns.items():
            acted_ns = np.unique(times_ns)
            first = np.diff(acted_ns, prepend=self._acted_ns.get(kind, _LONG_AGO_NS)) > apart_ns
            self._acted_ns[kind] = int(acted_ns[-1])
            for time_ns in acted_ns[first].tolist():
                yield Event(time_ns, "ERROR", f"fault: {kind}")

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
        seen = extent_of(run.measurement)
        if self._extent is None:
            try:
                model = build_model(run.recording.scenario)
                self._flight = model.flight if isinstance(model, FlightModel) else None
            except InputError as error:
                self._notes.append(f"no ground: the scenario cannot be built here ({error})")
            self._extent = _around(seen, self._planned()) if self._is_running else seen
            return self._extent
        if (self._extent.low_m <= seen.low_m).all() and (seen.high_m <= self._extent.high_m).all():
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


def _around(one: Extent, other: Extent) -> Extent:
    return Extent(np.minimum(one.low_m, other.low_m), np.maximum(one.high_m, other.high_m))


def beam_values(measured: Measurement) -> dict[str, FloatArray]:
    """Values by name, each (shots, beams), NaN where invalid."""
    range_m = np.where(measured.range_valid, measured.range_m, np.nan)
    speed_mps = np.where(measured.speed_valid, measured.closing_speed_mps, np.nan)
    return {
        "range_m": range_m,
        "closing_speed_mps": speed_mps,
        "range_error_m": range_m - measured.true_range_m,
        "closing_speed_error_mps": speed_mps - measured.true_closing_speed_mps,
    }


_POLL_NS = 100_000_000


def polls() -> Iterator[None]:
    """Ten instants a second, without end."""
    clock = Clock()
    while True:
        yield
        clock.wait(clock.now_ns() + _POLL_NS)


def follow(recording: Recording, note: Callable[[str], None]) -> Iterator[FlightPart | None]:
    """Yield what a recording holds, and then, ten times a second, what it has gained, until it is complete.

    The file is all that connects a viewer with a run, so that none can delay it.

    Args:
        note: takes what cannot be shown, with the reason.

    Raises:
        InputError: the recording is complete, and has no shot.
    """
    notes = list[str]()
    is_whole = recording.is_whole
    reader, parts = RunReader(recording), FlightParts(notes, is_running=not is_whole)
    for _ in polls():
        run = reader.next_part()
        yield None if run is None else parts.part(run)
        while notes:
            note(notes.pop(0))
        if is_whole:
            break
        is_whole = recording.is_whole
    if run is None:
        raise reader.shots.missing(str(recording.path))
    recording.warn_of_damage()

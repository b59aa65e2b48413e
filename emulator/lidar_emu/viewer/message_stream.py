"""A recorded flight as messages over time, in whichever vocabulary a viewer knows."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from operator import itemgetter
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.report.exports import dark_to_bright_rgb
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.viewer.beam_values import beam_values
from lidar_emu.viewer.events import Event
from lidar_emu.viewer.flight_parts import FlightPart
from lidar_emu.viewer.ground_mesh import GroundMesh

_PATH, _GROUND = "/path", "/ground"
STANDING = (_PATH, _GROUND)
"""Topics whose last message stands until the next."""


class Numbers(NamedTuple):
    """Values of one instant that belong together."""

    topic: str
    kind: str
    """Name of their type."""
    values: Mapping[str, float]


class Vocabulary(Protocol):
    """Messages of a kind of viewer; times are nanoseconds since 1970, positions in the site frame."""

    def vehicle(self, time_ns: int, position_m: FloatArray, site_from_body: FloatArray) -> Any:
        """Position and attitude, a quaternion (w, x, y, z)."""

    def path(self, time_ns: int, position_m: FloatArray) -> Any:
        """All positions so far."""

    def ground(self, time_ns: int, ground: GroundMesh) -> Any:
        """The ground."""

    def beams(self, time_ns: int, from_m: FloatArray, points_m: FloatArray, rgb: NDArray[np.uint8]) -> Any:
        """Lines from the vehicle to the points of a shot; they replace those of the shot before."""

    def points(
        self,
        time_ns: int,
        points_m: FloatArray,
        range_m: FloatArray,
        closing_speed_mps: FloatArray,
        beam: IntArray,
    ) -> Any:
        """Points of a shot, each with what its beam measured."""

    def numbers(self, time_ns: int, numbers: Numbers) -> Iterable[tuple[str, Any]]:
        """Topics and messages of values to plot."""

    def event(self, time_ns: int, event: Event) -> Any:
        """An event."""


_AGAIN_NS = 10**9
"""Foxglove Studio forgets, when one starts to play a file, what it drew of the first 0.1 s."""
_Messages = Iterator[tuple[int, str, Any]]
"""Nanoseconds since 1970, topic, message."""


def messages_of(part: FlightPart, vocabulary: Vocabulary) -> _Messages:
    """Yield the messages of a part of a recording in the order of their times.

    The times are those of the recording's own topics: scenario time on the scenario's epoch.
    """
    run = part.run
    epoch_ns, measured = run.recording.epoch_ns, run.measurement
    plotted = [
        *(_values(measured, beam, epoch_ns) for beam in range(measured.beam_count)),
        _lateness(run, epoch_ns),
    ]
    parts = [_plots(values, vocabulary) for values in plotted]
    parts.append(_events(part.events, epoch_ns, vocabulary))
    if run.is_flight:
        parts += [_still(part, epoch_ns, vocabulary), _flight(part, epoch_ns, vocabulary)]
    return heapq.merge(*parts, key=itemgetter(0))


def _still(part: FlightPart, epoch_ns: int, vocabulary: Vocabulary) -> _Messages:
    """What does not move: the ground and the path, at the first shot, and once again."""
    times_ns = _times_ns(part.run.measurement, 0, epoch_ns)
    again = (time_ns for time_ns in times_ns if time_ns >= times_ns[0] + _AGAIN_NS)
    for time_ns in (times_ns[0], *islice(again, 1)):
        if part.path_site_m is not None:
            yield time_ns, _PATH, vocabulary.path(time_ns, part.path_site_m)
        if part.ground is not None:
            yield time_ns, _GROUND, vocabulary.ground(time_ns, part.ground)


def _flight(part: FlightPart, epoch_ns: int, vocabulary: Vocabulary) -> _Messages:
    """For each shot the vehicle, its beams coloured by range, and its points."""
    measured = part.run.measurement
    valid = measured.range_valid
    rgb = np.zeros((*valid.shape, 3), dtype=np.uint8)
    rgb[valid] = dark_to_bright_rgb(measured.range_m[valid], part.range_span_m)
    for shot, time_ns in enumerate(_times_ns(measured, 0, epoch_ns)):
        position_m, beams = measured.position_site_m[shot], np.flatnonzero(valid[shot])
        points_m, speed_mps = measured.point_site_m[shot, beams], measured.closing_speed_mps[shot, beams]
        yield time_ns, "/tf", vocabulary.vehicle(time_ns, position_m, measured.site_from_body[shot])
        yield time_ns, "/beams", vocabulary.beams(time_ns, position_m, points_m, rgb[shot, beams])
        points = vocabulary.points(time_ns, points_m, measured.range_m[shot, beams], speed_mps, beams)
        yield time_ns, "/points", points


def _plots(values: Iterator[tuple[int, Numbers]], vocabulary: Vocabulary) -> _Messages:
    for time_ns, numbers in values:
        for topic, message in vocabulary.numbers(time_ns, numbers):
            yield time_ns, topic, message


def _values(measured: Measurement, beam: int, epoch_ns: int) -> Iterator[tuple[int, Numbers]]:
    """What a beam measured, NaN where invalid, at its own times of validity."""
    values = {name: of_beams[:, beam].tolist() for name, of_beams in beam_values(measured).items()}
    for shot, time_ns in enumerate(_times_ns(measured, beam, epoch_ns)):
        of_shot = {name: column[shot] for name, column in values.items()}
        yield time_ns, Numbers(f"/beam_{beam}", "Beam", of_shot)


def _lateness(run: RecordedRun, epoch_ns: int) -> Iterator[tuple[int, Numbers]]:
    if not run.keeps_time:
        return
    due_ns = run.deliveries.due_ns[run.deliveries.status == DeliveryStatus.SENT]
    for time_ns, late_us in zip(due_ns.tolist(), run.lateness_us.tolist(), strict=True):
        yield epoch_ns + time_ns, Numbers("/lateness", "Lateness", {"lateness_us": late_us})


def _events(events: list[Event], epoch_ns: int, vocabulary: Vocabulary) -> _Messages:
    for event in events:
        time_ns = epoch_ns + event.time_ns
        yield time_ns, "/events", vocabulary.event(time_ns, event)


def _times_ns(measured: Measurement, beam: int, epoch_ns: int) -> list[int]:
    """Times of validity of a beam; those of beam 0 stand for the shots."""
    times_ns: list[int] = (epoch_ns + measured.time_ns[:, beam]).tolist()
    return times_ns

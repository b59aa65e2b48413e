"""Read a recording for a viewer while it is being written."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from lidar_emu.recording.read import Recording
from lidar_emu.report.recorded_run import RunReader
from lidar_emu.runtime.clock import Clock
from lidar_emu.viewer.flight_parts import FlightPart, FlightParts

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
        recording: the recording.
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

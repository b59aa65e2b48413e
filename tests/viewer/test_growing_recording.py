"""A recording that is read while it grows, cut at any byte, is the recording that is read at once."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.measurement import Measurement
from lidar_emu.recording import mcap_file
from lidar_emu.recording.read import Recording, read_recording
from lidar_emu.report.recorded_run import RunReader, read_recorded_run
from lidar_emu.viewer.flight_parts import FlightPart, FlightParts

FAULTS = "[{kind: dropout, beams: [2], from_s: 0.5, to_s: 1}, {kind: lost, from_s: 1.1, to_s: 1.2}]"


@pytest.fixture(scope="module")
def recording(record) -> Recording:
    flown: Recording = record("powered_descent.yaml", duration_s="2", faults=FAULTS)
    return flown


class Growing:
    """A file that gains the bytes of a recording."""

    def __init__(self, path: Path, data: bytes) -> None:
        self._path, self._data, self._size = path, data, 0
        path.write_bytes(b"")

    def grow_to(self, size: int) -> None:
        with self._path.open("ab") as file:
            file.write(self._data[self._size : size])
        self._size = max(size, self._size)


def header_size(data: bytes) -> int:
    """Size at which the file can be opened: behind the declaration of its last topic."""
    return data.index(b"/event", data.index(b"/event") + 10) + 4096


def parts_of(data: bytes, cuts: list[int], path: Path) -> list[FlightPart]:
    growing, begin = Growing(path, data), header_size(data)
    growing.grow_to(begin)
    read = read_recording(path)
    reader, parts, found = RunReader(read), FlightParts([], is_running=True), []
    for size in [*sorted(begin + cut % (len(data) - begin) for cut in cuts), len(data)]:
        growing.grow_to(size)
        run = reader.next_part()
        if run is not None:
            found.append(parts.part(run))
    assert not read.damage
    return found


@pytest.mark.slow
@settings(max_examples=30)
@given(cuts=st.lists(st.integers(0, 1 << 30), max_size=40))
def test_any_cut(cuts: list[int], recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> None:
    data = recording.path.read_bytes()
    found = parts_of(data, cuts, tmp_path_factory.mktemp("growing") / "run.mcap")
    whole = read_recorded_run(recording)
    joined = Measurement.concatenate([part.run.measurement for part in found])
    for field in fields(Measurement):
        np.testing.assert_array_equal(getattr(joined, field.name), getattr(whole.measurement, field.name))
    for name in ("shot", "due_ns", "sent_ns", "status"):
        parts = [getattr(part.run.deliveries, name) for part in found]
        np.testing.assert_array_equal(np.concatenate(parts), getattr(whole.deliveries, name))
    (once,) = [FlightParts([], is_running=False).part(whole)]
    events = [event for part in found for event in part.events]
    assert sorted(events) == once.events
    assert len([event for event in events if event.text == "fault: dropout"]) == 1


def test_the_box_holds_the_flight_and_grows_seldom(recording: Recording, tmp_path: Path) -> None:
    data = recording.path.read_bytes()
    found = parts_of(data, list(range(0, len(data), 4096)), tmp_path / "run.mcap")
    assert len(found) > 20
    boxes = [part.extent for part in found if part.extent is not None]
    assert found[0].extent is not None
    assert len(boxes) < 4
    flown = read_recorded_run(recording).measurement
    hits_m = flown.true_point_site_m[flown.fired & np.isfinite(flown.true_point_site_m[..., 2])]
    for points_m in (flown.position_site_m, hits_m):
        assert (points_m >= boxes[-1].low_m).all()
        assert (points_m <= boxes[-1].high_m).all()
    shot_count, period_s = len(flown), 1 / recording.scenario.timing.rate_hz
    assert found[0].time_span_s == pytest.approx((0.0, shot_count * period_s))
    whole = FlightParts([], is_running=False).part(read_recorded_run(recording))
    assert whole.time_span_s == pytest.approx((flown.time_s.min(), flown.time_s.max()))
    paths = [part.path_site_m for part in found if part.path_site_m is not None]
    assert len(paths) == 2, "once in each second"
    np.testing.assert_array_equal(paths[-1], flown.position_site_m[: len(paths[-1])])


def test_before_the_first_shot_there_is_no_part(recording: Recording, tmp_path: Path) -> None:
    data = recording.path.read_bytes()
    path = tmp_path / "run.mcap"
    path.write_bytes(data[: header_size(data)])
    assert RunReader(read_recording(path)).next_part() is None


def test_what_is_written_during_a_pass_is_of_the_next_one(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A record is completed, and others follow it, while the place behind it is examined."""
    data = recording.path.read_bytes()
    growing, begin = Growing(tmp_path / "run.mcap", data), header_size(data)
    growing.grow_to(begin + 1000)
    read, scan = read_recording(tmp_path / "run.mcap"), mcap_file._next_record

    def scan_later(*arguments: Any) -> int | None:
        growing.grow_to(len(data))
        return scan(*arguments)

    reader = RunReader(read)
    monkeypatch.setattr(mcap_file, "_next_record", scan_later)
    parts = [reader.next_part(), reader.next_part()]
    assert not read.damage
    joined = Measurement.concatenate([part.measurement for part in parts if part is not None])
    np.testing.assert_array_equal(joined.shot, read_recorded_run(recording).measurement.shot)

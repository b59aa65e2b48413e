"""Properties of recordings over sequences of shots: each block is in the file at once, each time is compared."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.errors import InputError
from lidar_emu.recording import channels
from lidar_emu.recording.read import Recording, read_recording
from lidar_emu.recording.recompute import PacketDifference, recompute
from lidar_emu.recording.write import Recorder
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.runtime.run import Run
from lidar_emu.scenario.load import load
from lidar_emu.session import Block
from lidar_emu.shots.model import build_model
from lidar_emu.transports.spec import PortSpec

SHOTS = 15


class FileReader(Observer):
    """Counts the measurements in the file after each block, as a reader beside the run finds them."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._sent = 0
        self.counts: list[tuple[int, int]] = []

    def on_block_sent(self, block: Block) -> None:
        """Compare the shots sent so far with those in the file."""
        self._sent += len(block.measurement.shot)
        found = len(read_recording(self._path).json_messages(channels.MEASUREMENT))
        self.counts.append((self._sent, found))


@pytest.mark.parametrize("rate_hz", [7, 20])
def test_what_was_sent_is_in_the_file_after_each_block(rate_hz: int, tmp_path: Path) -> None:
    scenario = load("bench.yaml", {"duration_s": "5", "timing.rate_hz": str(rate_hz)})
    path, options = tmp_path / "r.mcap", RunOptions(PortSpec(), Pace.MAX)
    reader = FileReader(path)
    with Recorder(path, scenario, options) as recorder:
        Run(scenario, build_model(scenario), options, [recorder, reader]).fly()
    assert len(reader.counts) > 1
    assert [found for _, found in reader.counts] == [sent for sent, _ in reader.counts]


def test_two_runs_cannot_write_one_recording(tmp_path: Path) -> None:
    scenario = load("bench.yaml", {"duration_s": "1"})
    path, options = tmp_path / "r.mcap", RunOptions(PortSpec(), Pace.MAX)

    class SecondRun(Observer):
        def on_block_sent(self, _: Block) -> None:
            with (
                pytest.raises(InputError, match="must be a file that no run is writing"),
                Recorder(path, scenario, options) as second,
            ):
                second.on_opened("loopback", datetime.now(UTC))

    with Recorder(path, scenario, options) as first:
        Run(scenario, build_model(scenario), options, [first, SecondRun()]).fly()
    assert first.error is None
    shots = read_recording(path).json_messages(channels.MEASUREMENT)
    assert len(shots) == 10
    with Recorder(path, scenario, options) as later:
        Run(scenario, build_model(scenario), options, [later]).fly()
    assert later.error is None


@pytest.mark.parametrize("change", [b"", b"longer than before" * 100_000])
def test_a_recording_that_another_program_writes_is_reported(change: bytes, tmp_path: Path) -> None:
    scenario = load("bench.yaml", {"duration_s": "5"})
    path, options = tmp_path / "r.mcap", RunOptions(PortSpec(), Pace.MAX)

    class OtherProgram(Observer):
        def on_block_sent(self, _: Block) -> None:
            path.write_bytes(change)

    with Recorder(path, scenario, options) as recorder:
        Run(scenario, build_model(scenario), options, [recorder, OtherProgram()]).fly()
    assert recorder.error == f"{path}: another program changed the recording during the run"


def test_a_recording_that_another_program_extended_is_not_complete(tmp_path: Path) -> None:
    scenario = load("bench.yaml", {"duration_s": "5"})
    path, options = tmp_path / "r.mcap", RunOptions(PortSpec(), Pace.MAX)

    class OtherProgram(Observer):
        def on_block_sent(self, _: Block) -> None:
            with path.open("ab") as file:
                file.write(b"more")

    with Recorder(path, scenario, options) as recorder:
        Run(scenario, build_model(scenario), options, [recorder, OtherProgram()]).fly()
    assert recorder.error is not None
    assert not read_recording(path).is_whole


@given(
    between=st.lists(
        st.tuples(st.booleans(), st.one_of(st.none(), st.integers(-(10**9), 10**9))), min_size=1, max_size=9
    ),
    pace=st.sampled_from([Pace.WALL, Pace.MAX]),
)
def test_answers_are_recorded_when_they_left_the_device(
    between: list[tuple[bool, int | None]], pace: Pace, tmp_path_factory: pytest.TempPathFactory
) -> None:
    scenario = load("bench.yaml")
    path = tmp_path_factory.mktemp("between") / "r.mcap"
    with Recorder(path, scenario, RunOptions(PortSpec(), pace)) as recorder:
        recorder.on_opened("loopback", datetime.now(UTC))
        for number, (is_answer, _) in enumerate(between):
            called = recorder.on_acknowledgement if is_answer else recorder.on_housekeeping
            called(bytes([number]), 1000 * number)
        for _, sent_ns in between:
            recorder.on_sent_between(sent_ns)
    recording = read_recording(path)
    for channel, wanted in ((channels.ACKNOWLEDGEMENT, True), (channels.HOUSEKEEPING, False)):
        stated = [
            (sent_ns if pace is Pace.WALL else 1000 * number, bytes([number]))
            for number, (is_answer, sent_ns) in enumerate(between)
            if is_answer is wanted and sent_ns is not None
        ]
        found = [tuple(message) for message in recording.raw_messages(channel)]
        assert sorted(found) == sorted(stated)


def test_a_recording_may_be_a_device() -> None:
    scenario, options = load("bench.yaml", {"duration_s": "1"}), RunOptions(PortSpec(), Pace.MAX)
    with Recorder(Path("/dev/null"), scenario, options) as recorder:
        Run(scenario, build_model(scenario), options, [recorder]).fly()
    assert recorder.error is None


@pytest.fixture(scope="module")
def flight(record: Any) -> Recording:
    recording: Recording = record("bench.yaml", duration_s=str(SHOTS / 10))
    return recording


@settings(max_examples=20)
@given(
    shifts=st.dictionaries(
        st.integers(0, SHOTS - 1), st.integers(-(10**9), 10**9).filter(bool), min_size=1, max_size=4
    )
)
def test_each_due_time_is_compared_with_the_recomputed_one(flight: Recording, shifts: dict[int, int]) -> None:
    packets = flight.packets()
    expected = packets.due_ns.copy()
    for row, shift in shifts.items():
        packets.due_ns[row] += shift
    with patch.object(flight, "packets", lambda: packets):
        result = recompute(flight)
    first = min(shifts)
    assert (result.packets, result.different) == (SHOTS, len(shifts))
    assert result.first == PacketDifference(first, None, "due_ns", packets.due_ns[first], expected[first])

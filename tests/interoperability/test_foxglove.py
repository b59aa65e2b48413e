"""What Foxglove is given is what was simulated, by the format's own reader and by Rerun."""

from __future__ import annotations

import importlib.util
import os
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from lidar_emu import Measurement
from lidar_emu.cli import cli
from lidar_emu.errors import InputError

pytestmark = pytest.mark.slow
Messages = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def written(recorded: Path) -> Path:
    path = recorded / "flight.foxglove.mcap"
    assert f"{path}: 1008 shots of 4 beams" in report(recorded / "run.mcap", path)
    return path


@pytest.fixture(scope="module")
def messages(written: Path) -> Messages:
    """Times and messages by topic, in the file's order."""
    found: Messages = defaultdict(list)
    with written.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            found[channel.topic].append((message.log_time, decoded))
    return found


def report(recording: Path, path: Path) -> str:
    done = CliRunner().invoke(cli, ["report", str(recording), "--out", str(path)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def xyz(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def test_vehicle(messages: Messages, simulated: Measurement) -> None:
    transforms = [decoded.transforms[0] for _, decoded in messages["/tf"]]
    assert {(each.parent_frame_id, each.child_frame_id) for each in transforms} == {("site", "body")}
    np.testing.assert_array_equal([xyz(each.translation) for each in transforms], simulated.position_site_m)
    turned = [[each.rotation.w, *xyz(each.rotation)] for each in transforms]
    np.testing.assert_array_equal(turned, simulated.site_from_body)
    path = messages["/path"][0][1].entities[0].lines[0]
    np.testing.assert_array_equal([xyz(point) for point in path.points], simulated.position_site_m)


def test_points_and_beams(messages: Messages, simulated: Measurement) -> None:
    valid = simulated.range_valid
    for shot, (_, cloud) in enumerate(messages["/points"]):
        offsets = {field.name: field.offset for field in cloud.fields}
        rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)
        column = {
            name: rows[:, at : at + 8].copy().view("<f8").ravel()
            for name, at in offsets.items()
            if name != "beam"
        }
        beams = rows[:, offsets["beam"]]
        np.testing.assert_array_equal(beams, np.flatnonzero(valid[shot]))
        points_m = np.stack([column[name] for name in "xyz"], axis=1)
        np.testing.assert_array_equal(points_m, simulated.point_site_m[shot, beams])
        np.testing.assert_array_equal(column["range_m"], simulated.range_m[shot, beams])
        np.testing.assert_array_equal(column["closing_speed_mps"], simulated.closing_speed_mps[shot, beams])
        lines = messages["/beams"][shot][1].entities[0].lines[0]
        ends_m = np.reshape([xyz(point) for point in lines.points], (-1, 2, 3))
        np.testing.assert_array_equal(ends_m[:, 1], points_m)
        np.testing.assert_array_equal(ends_m[:, 0] - simulated.position_site_m[shot], 0)
        assert len(lines.colors) == len(lines.points)


def test_values_of_each_beam(messages: Messages, simulated: Measurement) -> None:
    for beam in range(4):
        of_beam = [decoded for _, decoded in messages[f"/beam_{beam}"]]
        for name, valid in (("range_m", simulated.range_valid), ("closing_speed_mps", simulated.speed_valid)):
            expected = np.where(valid, getattr(simulated, name), np.nan)[:, beam]
            np.testing.assert_array_equal([getattr(each, name) for each in of_beam], expected)
            quantity, _, unit = name.rpartition("_")
            error = expected - getattr(simulated, f"true_{name}")[:, beam]
            np.testing.assert_array_equal(
                [getattr(each, f"{quantity}_error_{unit}") for each in of_beam], error
            )


def test_times_are_in_order_and_those_of_the_recording(messages: Messages, recorded: Path) -> None:
    for topic, of_topic in messages.items():
        times = [time_ns for time_ns, _ in of_topic]
        assert times == sorted(times), topic
    with (recorded / "run.mcap").open("rb") as file:
        shots = {message.log_time for _, _, message in make_reader(file).iter_messages(topics=["/truth"])}
    assert {time_ns for time_ns, _ in messages["/tf"]} <= shots


def test_ground_and_path_come_again_after_the_first_second(messages: Messages) -> None:
    """Foxglove Studio forgets what it drew of the first 0.1 s when it starts to play."""
    for topic in ("/ground", "/path"):
        (first_ns, first), (again_ns, again) = messages[topic]
        assert first_ns == messages["/tf"][0][0]
        assert 1.0e9 <= again_ns - first_ns < 1.1e9
        (each,), (other,) = first.entities, again.entities
        assert (each.id, each.lines, each.triangles) == (other.id, other.lines, other.triangles)


def test_ground_and_events(messages: Messages, simulated: Measurement) -> None:
    ground = messages["/ground"][0][1].entities[0].triangles[0]
    assert max(ground.indices) < len(ground.points) == len(ground.colors)
    assert len(ground.indices) % 3 == 0
    texts = [decoded.message for _, decoded in messages["/events"]]
    was_lost = np.diff(simulated.range_valid, axis=0, prepend=True)
    of_beams = [text for text in texts if text.startswith("beam ")]
    assert len(of_beams) == np.count_nonzero(was_lost)


@pytest.mark.skipif(
    importlib.util.find_spec("rerun") is None, reason="not installed: pip install 'lidar-emu[view]'"
)
def test_rerun_reads_it(written: Path, simulated: Measurement, tmp_path: Path) -> None:
    import rerun_cli
    from rerun.chunk import RrdReader

    program, converted = Path(rerun_cli.__file__).parent / "rerun", tmp_path / "flight.rrd"
    environment = {**os.environ, "RERUN_ANALYTICS": "0"}
    subprocess.run(
        [program, "mcap", "convert", written, "-o", converted], env=environment, check=True, timeout=120
    )
    reader = RrdReader(str(converted))
    (recording,) = reader.recordings()
    positions_m, points_m = [], []
    for chunk in reader.stream(store=recording).to_chunks():
        batch = chunk.to_record_batch()
        for column, into in (("Transform3D:translation", positions_m), ("Points3D:positions", points_m)):
            if column in batch.schema.names:
                into += [each for each in batch.column(column).to_pylist() if each is not None]
    np.testing.assert_allclose(np.reshape(positions_m, (-1, 3)), simulated.position_site_m, rtol=1e-6)
    expected_m = simulated.point_site_m[simulated.range_valid]
    np.testing.assert_allclose(
        np.concatenate([each for each in points_m if each]), expected_m, rtol=1e-6, atol=1e-3
    )


def test_a_bench_pattern_has_values_alone(tmp_path: Path) -> None:
    arguments = [
        "run",
        "bench.yaml",
        "--duration",
        "1",
        "--pace",
        "max",
        "--record",
        str(tmp_path / "b.mcap"),
    ]
    assert CliRunner().invoke(cli, arguments, catch_exceptions=False).exit_code == 0
    assert "no flight to show" in report(tmp_path / "b.mcap", tmp_path / "b.foxglove.mcap")


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidar_emu.files.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install 'lidar-emu\[foxglove\]'"):
        report(Path("x.mcap"), tmp_path / "x.foxglove.mcap")

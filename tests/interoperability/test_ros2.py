"""Tools of ROS 2 read what was simulated: by mcap-ros2-support, rosbags and Rerun."""

from __future__ import annotations

import importlib.util
import os
import subprocess
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from waiting import LIMIT_S

from lidar_emu import Measurement
from lidar_emu.cli import cli
from lidar_emu.errors import InputError

pytestmark = pytest.mark.slow
Messages = dict[str, list[tuple[int, Any]]]
LINE_LIST, TRIANGLE_LIST, ADD = 5, 11, 0
FIELD_TYPES = {7: "<f4", 8: "<f8", 2: "u1"}


@pytest.fixture(scope="module")
def written(recorded: Path) -> Path:
    path = recorded / "flight.ros2.mcap"
    done = CliRunner().invoke(
        cli, ["report", str(recorded / "run.mcap"), "--out", str(path)], catch_exceptions=False
    )
    assert f"{path}: 1008 shots of 4 beams" in done.output
    return path


@pytest.fixture(scope="module")
def messages(written: Path) -> Messages:
    """Times and messages by topic, in the file's order."""
    found: Messages = defaultdict(list)
    with written.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            found[channel.topic].append((message.log_time, decoded))
    return found


def xyz(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def points_of(cloud: Any) -> Any:
    """A structured array of a cloud's points."""
    kind = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [FIELD_TYPES[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    assert (cloud.height, cloud.row_step, cloud.is_bigendian) == (1, cloud.width * cloud.point_step, False)
    return np.frombuffer(bytes(cloud.data), kind)


def test_vehicle(messages: Messages, simulated: Measurement) -> None:
    transforms = [decoded.transforms[0] for _, decoded in messages["/tf"]]
    frames = {(each.header.frame_id, each.child_frame_id) for each in transforms}
    assert frames == {("site", "body")}
    moved = [xyz(each.transform.translation) for each in transforms]
    np.testing.assert_array_equal(moved, simulated.position_site_m)
    turned = [[each.transform.rotation.w, *xyz(each.transform.rotation)] for each in transforms]
    np.testing.assert_array_equal(turned, simulated.site_from_body)
    for _, path in messages["/path"]:
        np.testing.assert_array_equal(
            [xyz(each.pose.position) for each in path.poses], simulated.position_site_m
        )


def test_stamps_are_log_times_in_order_and_those_of_the_recording(messages: Messages, recorded: Path) -> None:
    for topic in ("/points", "/beams", "/ground", "/path"):
        for time_ns, decoded in messages[topic]:
            assert decoded.header.frame_id == "site"
            assert decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec == time_ns
    for topic, of_topic in messages.items():
        times = [time_ns for time_ns, _ in of_topic]
        assert times == sorted(times), topic
    with (recorded / "run.mcap").open("rb") as file:
        shots = {message.log_time for _, _, message in make_reader(file).iter_messages(topics=["/truth"])}
    assert {time_ns for time_ns, _ in messages["/tf"]} <= shots


def test_ground_and_path_come_again_after_the_first_second(messages: Messages) -> None:
    """Foxglove Studio forgets what it drew of the first 0.1 s when it starts to play."""
    for topic in ("/ground", "/path"):
        first_ns, again_ns = (time_ns for time_ns, _ in messages[topic])
        assert first_ns == messages["/tf"][0][0]
        assert 1.0e9 <= again_ns - first_ns < 1.1e9


def test_points_and_beams(messages: Messages, simulated: Measurement) -> None:
    for shot, (_, cloud) in enumerate(messages["/points"]):
        points = points_of(cloud)
        beams = np.flatnonzero(simulated.range_valid[shot])
        np.testing.assert_array_equal(points["beam"], beams)
        points_m = simulated.point_site_m[shot, beams]
        placed_m = np.stack([points[name] for name in "xyz"], axis=1)
        np.testing.assert_array_equal(placed_m, points_m.astype(np.float32))
        for name in ("range_m", "closing_speed_mps"):
            np.testing.assert_array_equal(points[name], getattr(simulated, name)[shot, beams])
        marker = messages["/beams"][shot][1]
        assert (marker.type, marker.action, marker.ns, marker.id) == (LINE_LIST, ADD, "beams", 0)
        ends_m = np.reshape([xyz(point) for point in marker.points], (-1, 2, 3))
        np.testing.assert_array_equal(ends_m[:, 1], points_m)
        np.testing.assert_array_equal(ends_m[:, 0] - simulated.position_site_m[shot], 0)
        assert len(marker.colors) == len(marker.points)
        longest_m = simulated.range_m[shot, beams].max(initial=0.0)
        assert 0.005 * longest_m <= marker.scale.x <= 0.01 * longest_m


def test_values_and_events(messages: Messages, simulated: Measurement) -> None:
    for beam in range(4):
        for name, valid in (("range_m", simulated.range_valid), ("closing_speed_mps", simulated.speed_valid)):
            quantity, _, unit = name.rpartition("_")
            expected = np.where(valid, getattr(simulated, name), np.nan)[:, beam]
            error = expected - getattr(simulated, f"true_{name}")[:, beam]
            for topic, values in ((name, expected), (f"{quantity}_error_{unit}", error)):
                of_beam = messages[f"/beam_{beam}/{topic}"]
                np.testing.assert_array_equal([decoded.data for _, decoded in of_beam], values)
                assert np.ptp(np.array([time_ns for time_ns, _ in of_beam]) - simulated.time_ns[:, beam]) == 0
    lost = np.diff(simulated.range_valid, axis=0, prepend=True)
    of_beams = [decoded for _, decoded in messages["/events"] if decoded.msg.startswith("beam ")]
    assert len(of_beams) == np.count_nonzero(lost)
    assert {decoded.level for decoded in of_beams} == {20, 30}


def test_ground(messages: Messages, simulated: Measurement) -> None:
    (first, _), (second, _) = [
        (np.array([xyz(point) for point in ground.points]), ground) for _, ground in messages["/ground"]
    ]
    marker = messages["/ground"][0][1]
    assert (marker.type, marker.action, xyz(marker.scale)) == (TRIANGLE_LIST, ADD, [1, 1, 1])
    assert len(first) % 3 == 0
    assert len(first) == len(marker.colors) > 10_000
    grey = np.array([(colour.r, colour.g, colour.b, colour.a) for colour in marker.colors])
    assert (grey[:, :3] == grey[:, :1]).all()
    assert (grey[:, 3] == 1).all()
    assert 0.0 < grey[:, 0].min() < 0.3, "shadows"
    assert 0.8 < grey[:, 0].max() <= 1.0, "slopes that face the sun"
    assert np.isfinite(first).all()
    sides_m = np.diff(first.reshape(-1, 3, 3)[..., :2], axis=1)
    assert (np.linalg.det(sides_m) > 0).all(), "faces look up"
    hit_m = simulated.true_point_site_m[np.isfinite(simulated.true_point_site_m[..., 2])]
    assert (first[:, :2].min(axis=0) <= hit_m[:, :2].min(axis=0)).all()
    assert (first[:, :2].max(axis=0) >= hit_m[:, :2].max(axis=0)).all()
    np.testing.assert_array_equal(first, second)


def test_a_bench_pattern_has_values_alone(tmp_path: Path) -> None:
    run = ["run", "bench.yaml", "--duration", "1", "--pace", "max", "--record", str(tmp_path / "b.mcap")]
    assert CliRunner().invoke(cli, run, catch_exceptions=False).exit_code == 0
    arguments = ["report", str(tmp_path / "b.mcap"), "--out", str(tmp_path / "b.ros2.mcap")]
    assert "no flight to show" in CliRunner().invoke(cli, arguments, catch_exceptions=False).output


def test_rosbags_reads_it(written: Path, messages: Messages) -> None:
    with AnyReader([written]) as reader:
        counts = Counter(connection.topic for connection, _, _ in reader.messages())
    assert counts == {topic: len(of_topic) for topic, of_topic in messages.items()}


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="not installed: pip install '.[view]'")
def test_rerun_reads_it(written: Path, simulated: Measurement, tmp_path: Path) -> None:
    import rerun_cli
    from rerun.chunk import RrdReader

    program, converted = Path(rerun_cli.__file__).parent / "rerun", tmp_path / "flight.rrd"
    environment = {**os.environ, "RERUN_ANALYTICS": "0"}
    convert = [program, "mcap", "convert", written, "-o", converted]
    subprocess.run(convert, env=environment, check=True, timeout=LIMIT_S)
    reader = RrdReader(str(converted))
    (recording,) = reader.recordings()
    counts: Counter[str] = Counter()
    for chunk in reader.stream(store=recording).to_chunks():
        batch = chunk.to_record_batch()
        for name in ("Transform3D:translation", "Points3D:positions"):
            if name in batch.schema.names:
                found = [each for each in batch.column(name).to_pylist() if each is not None]
                counts[f"{chunk.entity_path} {name}"] += sum(len(each) for each in found)
    assert counts["/points Points3D:positions"] == np.count_nonzero(simulated.range_valid)
    assert counts["/tf Transform3D:translation"] == len(simulated)


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidar_emu.files.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install .*\[ros\]'$"):
        CliRunner().invoke(
            cli, ["report", "x.mcap", "--out", str(tmp_path / "x.ros2.mcap")], catch_exceptions=False
        )

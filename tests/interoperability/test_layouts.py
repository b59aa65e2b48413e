"""Layouts name topics and fields that the files have, and all that the files have to plot."""

from __future__ import annotations

import importlib
import importlib.util
import json
import re
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory

from lidar_emu import Measurement
from lidar_emu.cli import cli
from lidar_emu.report.recorded_run import RecordedRun

pytestmark = pytest.mark.slow
ENDINGS = ("ros2.mcap", "foxglove.json")


def report(recording: Path, *paths: Path) -> None:
    options = [option for path in paths for option in ("--out", str(path))]
    done = CliRunner().invoke(cli, ["report", str(recording), *options], catch_exceptions=False)
    assert done.exit_code == 0, done.output


@pytest.fixture(scope="module", params=[False, True], ids=["without deadlines", "with deadlines"])
def folder(request: pytest.FixtureRequest, recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files and layouts of a descent, `flight.*`."""
    folder: Path = tmp_path_factory.mktemp("layouts")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RecordedRun, "keeps_time", request.param)
        report(recorded / "run.mcap", *(folder / f"flight.{ending}" for ending in ENDINGS))
    return folder


@pytest.fixture
def layout(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "flight.foxglove.json").read_text())
    return content


def numbers(path: Path) -> set[str]:
    """Topics of all numbers to plot, by the file's own schemas."""
    return {topic for topic, schema in channels(path).items() if schema == "std_msgs/msg/Float64"}


def channels(path: Path) -> dict[str, str]:
    """The schema of each topic."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return {each.topic: summary.schemas[each.schema_id].name for each in summary.channels.values()}


def leaves(tree: Any) -> list[str]:
    return [tree] if isinstance(tree, str) else leaves(tree["first"]) + leaves(tree["second"])


def test_foxglove_plots_each_number_of_the_file(folder: Path, layout: dict[str, Any]) -> None:
    plotted = [curve["value"] for panel in layout["configById"].values() for curve in panel.get("paths", ())]
    assert len(plotted) == len(set(plotted)) >= 16
    assert set(plotted) == {f"{topic}.data" for topic in numbers(folder / "flight.ros2.mcap")}


def test_foxglove_shows_topics_and_frames_of_the_file(folder: Path, layout: dict[str, Any]) -> None:
    schemas, panels = channels(folder / "flight.ros2.mcap"), layout["configById"]
    flight = panels["3D!flight"]
    drawn = {
        topic
        for topic, schema in schemas.items()
        if schema in ("visualization_msgs/msg/Marker", "nav_msgs/msg/Path", "sensor_msgs/msg/PointCloud2")
    }
    assert set(flight["topics"]) == drawn
    assert schemas[panels["RosOut!events"]["topicToRender"]] == "rcl_interfaces/msg/Log"
    with (folder / "flight.ros2.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        *_, transforms = next(reader.iter_decoded_messages(topics=["/tf"]))
        *_, cloud = next(reader.iter_decoded_messages(topics=["/points"]))
    frames = {transforms.transforms[0].header.frame_id, transforms.transforms[0].child_frame_id}
    assert flight["followTf"] in frames
    assert {name.removeprefix("frame:") for name in flight["transforms"]} == frames
    assert flight["topics"]["/points"]["colorField"] in {field.name for field in cloud.fields}


def test_foxglove_arranges_each_panel_once(layout: dict[str, Any]) -> None:
    arranged = leaves(layout["layout"])
    assert sorted(arranged) == sorted(layout["configById"])
    curves = layout["layout"]["second"]
    assert layout["configById"][curves["first"]]["showLegend"]
    assert curves["splitPercentage"] > 100 / len(leaves(curves))  # room for the legend


def test_foxglove_camera_and_colours_fit_the_flight(layout: dict[str, Any], simulated: Measurement) -> None:
    flight = layout["configById"]["3D!flight"]
    camera, points = flight["cameraState"], flight["topics"]["/points"]
    phi, theta = np.radians([camera["phi"], camera["thetaOffset"]])
    to_eye = np.array([-np.sin(phi) * np.sin(theta), -np.sin(phi) * np.cos(theta), np.cos(phi)])
    eye_m = camera["targetOffset"] + camera["distance"] * to_eye
    seen_m = np.concatenate([simulated.position_site_m, simulated.point_site_m[simulated.range_valid]])
    ahead = (seen_m - eye_m) @ -to_eye / np.linalg.norm(seen_m - eye_m, axis=1)
    assert ahead.min() > np.cos(np.radians(camera["fovy"] / 2))
    assert camera["near"] < np.linalg.norm(seen_m - eye_m, axis=1).min()
    assert np.linalg.norm(seen_m - eye_m, axis=1).max() < camera["far"]
    speed_mps = simulated.closing_speed_mps[simulated.range_valid & simulated.speed_valid]
    assert (points["minValue"], points["maxValue"]) == (speed_mps.min(), speed_mps.max())


def test_a_bench_pattern_has_no_scene(tmp_path: Path) -> None:
    run = ["run", "bench.yaml", "--duration", "1", "--pace", "max", "--record", str(tmp_path / "b.mcap")]
    assert CliRunner().invoke(cli, run, catch_exceptions=False).exit_code == 0
    paths = [tmp_path / f"b.{ending}" for ending in ENDINGS]
    report(tmp_path / "b.mcap", *paths)
    layout = json.loads(paths[1].read_text())
    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    assert not [name for name in layout["configById"] if name.startswith("3D")]


def test_a_file_is_chunked_and_indexed_and_a_cut_one_holds_its_whole_chunks(
    folder: Path, tmp_path: Path
) -> None:
    path = folder / "flight.ros2.mcap"
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        whole = [
            (channel.topic, message.log_time)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(whole)
    chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
    assert len(chunks) > 1
    assert all(
        each.chunk_start_offset + each.chunk_length <= then.chunk_start_offset
        for each, then in pairwise(chunks)
    )
    last = chunks[-1]
    cut = tmp_path / path.name
    cut.write_bytes(path.read_bytes()[: last.chunk_start_offset + last.chunk_length // 2])
    read = []
    with cut.open("rb") as file:
        messages = NonSeekingReader(file).iter_messages(log_time_order=False)
        with suppress(EndOfFile):
            for _, channel, message in messages:
                read.append((channel.topic, message.log_time))
    assert 0 < len(read) < len(whole)
    assert read == whole[: len(read)]


@pytest.mark.skipif(
    importlib.util.find_spec("foxglove") is None, reason="not installed: pip install foxglove-sdk"
)
def test_foxglove_knows_each_setting(layout: dict[str, Any]) -> None:
    """The models of Foxglove's own library for layouts take each setting, and write it as it is here."""
    layouts = importlib.import_module("foxglove.layouts")

    def model(kind: str, settings: dict[str, Any], **nested: Any) -> Any:
        snake = {
            re.sub("[A-Z]", lambda found: "_" + found[0].lower(), name): value
            for name, value in settings.items()
        }
        return getattr(layouts, kind)(**(snake | nested))

    def check(built: Any, settings: dict[str, Any]) -> None:
        written = json.loads(built.to_json())
        assert {name: written[name] for name in settings} == settings

    panels = layout["configById"]
    for name, panel in panels.items():
        if name.startswith("Plot!"):
            settings = {key: value for key, value in panel.items() if key != "foxglovePanelTitle"}
            check(
                model("PlotConfig", settings, paths=[model("PlotSeries", each) for each in panel["paths"]]),
                settings,
            )
    check(model("LogConfig", panels["RosOut!events"]), panels["RosOut!events"])
    flight = panels["3D!flight"]
    check(model("ThreeDeeCameraState", flight["cameraState"]), flight["cameraState"])
    axes = {key: value for key, value in flight["scene"]["transforms"].items() if key != "axisScale"}
    check(model("BaseRendererTransforms", axes), axes)
    points = flight["topics"]["/points"]
    check(model("BaseRendererPointCloudTopicSettings", points), points)
    path = flight["topics"]["/path"]
    check(model("BaseRendererPosesTopicSettings", path), path)
    for name in ("scene", "transforms", "topics", "layers", "camera_state", "follow_tf", "follow_mode"):
        assert name in layouts.ThreeDeeConfig.__dataclass_fields__

"""What the Rerun viewer is given is what was simulated, and a browser shows it."""

from __future__ import annotations

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import browser
import numpy as np
import pytest
from click.testing import CliRunner
from waiting import LIMIT_S, eventually

from lidar_emu import Measurement, load
from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.recording.read import read_recording
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.recorded_run import RunReader
from lidar_emu.shots.model import build_model
from lidar_emu.viewer.flight_parts import FlightParts
from lidar_emu.viewer.layouts import PATH_RGB
from lidar_emu.viewer.rerun_viewer import RerunLog

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("rerun") is None, reason="not installed: pip install '.[view]'"
    ),
]


def view(*arguments: str) -> str:
    done = CliRunner().invoke(cli, ["view", *arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def chunks(path: Path) -> dict[tuple[str, str], Any]:
    """Columns by entity and component, as Rerun's own reader returns them."""
    from rerun.chunk import RrdReader

    reader = RrdReader(str(path))
    (recording,) = reader.recordings()
    found: dict[tuple[str, str], Any] = {}
    for chunk in reader.stream(store=recording).to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            key = chunk.entity_path, name.rpartition(":")[2]
            found[key] = [*found.get(key, []), *batch.column(name).to_pylist()]
    return found


@pytest.fixture(scope="module")
def viewed(recorded: Path) -> dict[tuple[str, str], Any]:
    view(str(recorded / "run.mcap"), "--save", str(recorded / "run.rrd"))
    return chunks(recorded / "run.rrd")


def test_values_of_each_beam(viewed: dict[tuple[str, str], Any], simulated: Measurement) -> None:
    for name, valid in (("range_m", simulated.range_valid), ("closing_speed_mps", simulated.speed_valid)):
        truth = getattr(simulated, f"true_{name}")
        for beam in range(simulated.beam_count):
            of_beam = valid[:, beam]
            expected = getattr(simulated, name)[of_beam, beam]
            shown = np.ravel(viewed[f"/{name}/beam_{beam}", "scalars"])
            np.testing.assert_array_equal(shown, expected)
            quantity, _, unit = name.rpartition("_")
            error = np.ravel(viewed[f"/{quantity}_error_{unit}/beam_{beam}", "scalars"])
            np.testing.assert_allclose(error, expected - truth[of_beam, beam], rtol=0, atol=1e-12)


def test_a_beam_has_one_colour_in_all_viewers(
    viewed: dict[tuple[str, str], Any], simulated: Measurement
) -> None:
    for beam in range(simulated.beam_count):
        (colours,) = viewed[f"/range_m/beam_{beam}", "colors"]
        assert [f"#{rgba >> 8:06x}" for rgba in colours] == [beam_colour(beam)]
    for entity in ("/site/beams", "/site/points"):
        first = [f"#{rgba >> 8:06x}" for rgba in viewed[entity, "colors"][0]]
        assert first == [beam_colour(beam) for beam in np.flatnonzero(simulated.range_valid[0])]


def test_vehicle_beams_and_points(viewed: dict[tuple[str, str], Any], simulated: Measurement) -> None:
    """The positions are single-precision numbers."""
    position_m = np.reshape(viewed["/site/vehicle", "translation"], (-1, 3))
    np.testing.assert_allclose(position_m, simulated.position_site_m, rtol=1e-6)
    attitude = np.reshape(viewed["/site/vehicle", "quaternion"], (-1, 4))
    np.testing.assert_allclose(attitude[:, [3, 0, 1, 2]], simulated.site_from_body, rtol=0, atol=1e-7)
    for shot, points_m in enumerate(viewed["/site/points", "positions"]):
        expected_m = simulated.point_site_m[shot, simulated.range_valid[shot]]
        np.testing.assert_allclose(np.reshape(points_m, (-1, 3)), expected_m, rtol=1e-5, atol=1e-3)
        ends_m = np.reshape(viewed["/site/beams", "strips"][shot], (-1, 2, 3))
        np.testing.assert_array_equal(ends_m[:, 1], np.reshape(points_m, (-1, 3)))


def test_ground_lies_on_the_scene(viewed: dict[tuple[str, str], Any]) -> None:
    (vertices_m,) = viewed["/site/ground", "vertex_positions"]
    (triangles,) = viewed["/site/ground", "triangle_indices"]
    corners_m = np.array(vertices_m)[np.array(triangles)]
    scene = build_model(load("descent.yaml")).flight.scene  # type: ignore[union-attr]
    centre_m = corners_m.mean(axis=1)
    height_m = scene.height_m(centre_m[:, 0], centre_m[:, 1])
    assert np.quantile(np.abs(centre_m[:, 2] - height_m), 0.9) < 1.0
    first, second = corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]
    assert (np.cross(first, second)[:, 2] > 0).all(), "triangles face upward"


def test_lost_beams_and_faults_are_events(tmp_path: Path) -> None:
    recording, saved = str(tmp_path / "run.mcap"), tmp_path / "run.rrd"
    faults = "faults=[{kind: dropout, beams: [2], from_s: 0.5, to_s: 1}]"
    run = ["run", "descent.yaml", "--pace", "max", "--duration", "2", "--record", recording, "--set", faults]
    assert CliRunner().invoke(cli, run, catch_exceptions=False).exit_code == 0
    view(recording, "--save", str(saved))
    found = chunks(saved)
    texts = [text for row in found["/events", "text"] for text in row]
    times_s = [time.total_seconds() for time in found["/events", "scenario_time"]]
    assert texts.count("fault: dropout") == 1
    assert times_s[texts.index("fault: dropout")] == pytest.approx(0.5, abs=0.051)
    lost = texts.index("beam 2: below_threshold", texts.index("fault: dropout") - 2)
    assert times_s[lost] == pytest.approx(0.5, abs=0.051)
    back = len(texts) - texts[::-1].index("beam 2: valid") - 1
    assert times_s[back] >= 0.95


def test_a_bench_pattern_has_no_flight_to_show(tmp_path: Path) -> None:
    recording = str(tmp_path / "run.mcap")
    run = ["run", "bench.yaml", "--pace", "max", "--duration", "1", "--record", recording]
    assert CliRunner().invoke(cli, run, catch_exceptions=False).exit_code == 0
    assert "no flight to show" in view(recording, "--save", str(tmp_path / "run.rrd"))
    assert ("/range_m/beam_0", "scalars") in chunks(tmp_path / "run.rrd")


def test_parts_are_shown_as_the_whole(
    recorded: Path, tmp_path: Path, viewed: dict[tuple[str, str], Any]
) -> None:
    """A recording that grows, sent to the viewer piece by piece."""
    data, growing = (recorded / "run.mcap").read_bytes(), tmp_path / "growing.mcap"
    growing.write_bytes(data[:100_000])
    recording = read_recording(growing)
    log = RerunLog(recording, is_running=True)
    log.stream.save(tmp_path / "live.rrd")
    reader, parts = RunReader(recording), FlightParts([], is_running=True)
    for end in range(200_000, len(data) + 100_000, 100_000):
        run = reader.next_part()
        assert run is not None
        log.show(parts.part(run))
        growing.write_bytes(data[:end])
    last = reader.next_part()
    assert last is not None
    log.show(parts.part(last))
    log.stream.disconnect()
    live = chunks(tmp_path / "live.rrd")
    scalars = [key for key in viewed if key[1] == "scalars"]
    assert len(scalars) == 16
    for key in (
        *scalars,
        ("/site/vehicle", "translation"),
        ("/site/points", "positions"),
        ("/events", "text"),
    ):
        assert live[key] == viewed[key], key


@pytest.mark.parametrize(
    ("arguments", "refusal"),
    [
        (("missing.mcap", "--save", "x.rrd"), "missing.mcap"),
        (("{run}", "--save", "x.txt"), "must end in .rrd"),
        (("{run}", "--save", "x.rrd", "--web"), "--web: with --save; pass one of them"),
        (("{run}", "--port", "9000"), "needs --web or --foxglove"),
        (("{run}", "--save", "nowhere/x.rrd"), "nowhere"),
    ],
)
def test_what_cannot_be_done_is_refused(arguments: tuple[str, ...], refusal: str, recorded: Path) -> None:
    named = [each.format(run=recorded / "run.mcap") for each in arguments]
    with pytest.raises(InputError) as refused:
        view(*named)
    assert refusal in str(refused.value)


def two_free_ports() -> int:
    """The first of two ports that are free."""
    while True:
        with socket.create_server(("127.0.0.1", 0)) as first:
            port = int(first.getsockname()[1])
            try:
                socket.create_server(("127.0.0.1", port + 1)).close()
            except OSError:
                continue
        return port


def is_there(url: str) -> bool:
    try:
        urllib.request.urlopen(url, timeout=LIMIT_S).close()
    except (urllib.error.URLError, ConnectionError):
        return False
    return True


@pytest.mark.skipif(browser.PROGRAM is None, reason="not installed: chromium")
def test_a_browser_on_this_machine_shows_it(recorded: Path, tmp_path: Path) -> None:
    port = two_free_ports()
    command = [
        sys.executable,
        "-m",
        "lidar_emu",
        "view",
        str(recorded / "run.mcap"),
        "--web",
        "--port",
        str(port),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url, _, _ = process.stdout.readline().partition(",")
            eventually(lambda: is_there(f"http://127.0.0.1:{port}"))
            with socket.socket() as elsewhere:
                assert elsewhere.connect_ex(("127.0.0.2", port)) != 0, "it listens on 127.0.0.1 alone"
            with browser.browser(url, tmp_path) as page:
                eventually(
                    lambda: (np.abs(page.picture().astype(int) - PATH_RGB).sum(axis=2) < 30).sum() > 100
                )
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0
    assert not is_there(f"http://127.0.0.1:{port}")


def test_a_run_shows_itself_until_ctrl_c(tmp_path: Path) -> None:
    port = two_free_ports()
    run = ["run", "descent.yaml", "--duration", "1", "--plain", "--view", f"web:{port}"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-m", "lidar_emu", *run], env=environment, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stderr is not None
            assert process.stderr.readline().startswith(f"viewer: http://127.0.0.1:{port}?url=")
            assert process.stderr.readline() == "the viewer is open; Ctrl-C ends it\n"
            eventually(lambda: is_there(f"http://127.0.0.1:{port}"))
            assert list(tmp_path.glob("lidar-emu-*/run.mcap"))
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0
    assert not is_there(f"http://127.0.0.1:{port}")
    assert not list(tmp_path.glob("lidar-emu-*"))

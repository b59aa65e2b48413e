"""What a recording shows, compared with the report of the run itself, also if the file was cut."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.measurement import COLUMNS
from lidar_emu.recording.read import read_recording
from lidar_emu.report.figures import Figures
from lidar_emu.report.html_parts import figure_element
from lidar_emu.report.recorded_run import REPORTED, RecordedRun, read_recorded_run
from lidar_emu.runtime.port.packets import DeliveryStatus

READY = '{"ready": {"port": "in-memory loopback"}}\n'
FAULTS = "faults=[{kind: dropout, beams: [2], from_s: 0.5, to_s: 1}, {kind: lost, from_s: 1, to_s: 1.2}]"


@pytest.fixture(scope="module")
def bench_flown(record) -> RecordedRun:
    return read_recorded_run(record("bench.yaml", duration_s="2"))


def test_it_is_the_summary_of_the_run(tmp_path, monkeypatch):
    run = [
        "run",
        "bench.yaml",
        "--json",
        "--pace",
        "max",
        "--record",
        "r.mcap",
        "--duration",
        "2",
        "--set",
        FAULTS,
    ]
    report = ["report", "r.mcap", "--json", "--out", "r.npz", "--out", "r.pcap"]
    monkeypatch.chdir(tmp_path)
    ran, reported = (
        json.loads(CliRunner().invoke(cli, words).stdout.removeprefix(READY)) for words in (run, report)
    )
    same = (
        "scenario",
        "seed",
        "rate_hz",
        "started_utc",
        "port",
        "pace",
        "shots",
        "beams",
        "lateness",
        "faults",
    )
    assert {name: reported[name] for name in same} == {name: ran[name] for name in same}
    assert ran["faults"]["suppressed"] == 2
    for name in ("range_error_m", "speed_error_mps"):
        assert reported[name] == pytest.approx(ran[name], rel=1e-9)
    with np.load(tmp_path / "r.npz") as table:
        assert len(table["range_m"]) == 20 * 4
    assert (tmp_path / "r.pcap").stat().st_size > 18 * 100


def test_a_file_that_was_cut_anywhere_is_read_or_refused(bench_flown, tmp_path):
    data = bench_flown.recording.path.read_bytes()
    shots = []
    for share in np.linspace(0.0, 1.0, 23):
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[: int(share * len(data))])
        try:
            flown = read_recorded_run(read_recording(path))
        except InputError:
            continue
        assert flown.recording.is_whole == (share == 1.0)
        assert flown.contents()["measured"] == len(flown.measurement)
        shots.append(len(flown.measurement))
    assert shots[-1] == 20
    assert shots == sorted(shots)
    assert shots[0] < 20


def test_a_recording_without_a_column_is_refused_in_one_line(bench_flown, tmp_path):
    path = tmp_path / "other.mcap"
    path.write_bytes(bench_flown.recording.path.read_bytes().replace(b'"residual_mps":', b'"residual_mpz":'))
    with pytest.raises(InputError, match="residual_mps"):
        read_recorded_run(read_recording(path))


@pytest.mark.slow
def test_a_report_shows_nothing_of_the_columns_that_it_does_not_read(record):
    recording = record("descent.yaml", duration_s="1", faults="[{kind: dropout, beams: [2], from_s: 0.5}]")
    read = [read_recorded_run(recording, columns) for columns in (REPORTED, COLUMNS)]
    partial, whole = ((run.contents(), list(map(figure_element, Figures(run, ())))) for run in read)
    assert len(partial[1]) == 8
    assert partial == whole


def test_all_packets_late(bench_flown):
    deliveries = replace(
        bench_flown.deliveries,
        status=np.full_like(bench_flown.deliveries.status, DeliveryStatus.LATE),
        sent_ns=np.full_like(bench_flown.deliveries.sent_ns, -1),
    )
    late = replace(bench_flown, deliveries=deliveries)
    assert late.contents()["shots"]["late"] == 20
    assert late.contents()["shots"]["sent"] == 0
    assert "lateness" not in {drawing.name for drawing in Figures(late, ())}


def test_lateness_is_drawn_where_time_was_kept(bench_flown):
    recording = bench_flown.recording
    deliveries = bench_flown.deliveries
    kept = replace(bench_flown, deliveries=replace(deliveries, sent_ns=deliveries.due_ns + 1500))
    recording.origin = {**recording.origin, "pace": "wall"}
    drawings = {drawing.name: drawing for drawing in Figures(kept, ())}
    with pytest.MonkeyPatch.context() as patch:
        wire = recording.scenario.wire.model_copy(update={"polled": True})
        patch.setattr(recording, "scenario", recording.scenario.model_copy(update={"wire": wire}))
        polled = Figures(kept, ())
        assert "lateness" not in {drawing.name for drawing in polled}
        assert "No lateness: packets waited for the host." in polled.notes
        assert kept.contents()["lateness"]["count"] == 0
    assert kept.contents()["lateness"]["count"] == 20
    recording.origin = {**recording.origin, "pace": "max"}
    assert drawings["lateness"].description == (
        "From due to written: 50th percentile 2 us, 99th 2 us, largest 2 us."
    )


def test_a_bench_pattern_states_why_it_has_no_path(bench_flown):
    figures = Figures(bench_flown, ())
    assert {drawing.name for drawing in figures} == {"truth", "errors", "signal", "validity"}
    assert any("bench pattern" in note for note in figures.notes)
    assert figures.plan is not None


def test_a_flight_without_a_valid_measurement_has_a_path(record):
    blind = read_recorded_run(
        record("descent.yaml", duration_s="0.2", instrument__detection__maximum_range_m="10")
    )
    assert not blind.measurement.range_valid.any()
    figures = Figures(blind, ())
    assert [drawing.name for drawing in figures] == ["path", "motion", "signal", "validity"]
    assert any("no measurement is valid" in note for note in figures.notes)


def test_a_scenario_whose_files_are_gone_is_drawn_without_them(record, tmp_path):
    ground = tmp_path / "gone.npz"
    up_m = np.zeros((16, 16))
    np.savez(ground, elevation_m=up_m, pixel_m=500.0)
    flown = read_recorded_run(
        record(
            "descent.yaml", duration_s="0.2", site__ground=f"{{kind: grid, file: {ground}, beyond: plane}}"
        )
    )
    ground.unlink()
    figures = Figures(flown, ())
    assert {drawing.name for drawing in figures} == {
        "path",
        "motion",
        "truth",
        "errors",
        "signal",
        "validity",
    }
    assert figures.plan is None
    assert any("gone.npz" in note for note in figures.notes)

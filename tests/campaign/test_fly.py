"""Campaigns flown by any number of processes, in any order, and with deaths among them: the same files."""

from __future__ import annotations

import fcntl
import json
import multiprocessing
import os
import subprocess
import sys
from collections import Counter

import numpy as np
import pyarrow
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet
from small_campaign import ROWS, SMALL, Here, content

import lidar_emu
from lidar_emu.campaign.batch import fly_batch, measure_run, warm_up
from lidar_emu.campaign.description import prepare
from lidar_emu.campaign.run import LocalPool, compile_kernels, fly_campaign, runs_per_file
from lidar_emu.campaign.tables import read_columns
from lidar_emu.errors import InputError, RunError
from lidar_emu.measurement import TABLE
from lidar_emu.numerics.compilation import report_compilation


def runs_of(folder):
    return parquet.read_table(folder / "runs").to_pylist()


BOUND = {"m": 8e-6, "m/s": 1.2e-7, "m/s²": 1.2e-7, "deg": 8e-6, "dB": 5e-4, "": 5e-10, "rad/s": 5e-10}
"""What docs/campaigns.md states of rounding, by unit."""


def test_a_run_is_the_scenario_with_what_was_drawn(fly, tmp_path):
    fly()
    for row in runs_of(tmp_path / "out"):
        drawn = {key: json.dumps(value) for key, value in row.items() if "." in key or key == "instrument"}
        fixed = {"site": "flat", "duration_s": "0.4", "instrument.optics.beamlets": "1"}
        order = {"instrument": drawn.pop("instrument")}
        scenario = lidar_emu.load("descent.yaml", order | fixed | drawn)
        alone = lidar_emu.simulate(scenario, seed=row["seed"]).table()
        filters = [("run", "=", row["run"])]
        kept = parquet.read_table(tmp_path / "out" / "beams", filters=filters).to_pydict()
        assert row["failed"] is None
        for name, column in alone.items():
            if not name.startswith("true_beam_axis"):
                stored = np.array(kept[name], dtype=column.dtype)
                bound = BOUND.get(TABLE[name].unit, 0) / (256 if "sigma" in name else 1)
                np.testing.assert_allclose(stored, column, rtol=0, atol=bound, err_msg=name)


class Backwards(Here):
    """The last batch is done first."""

    def __init__(self):
        super().__init__(slots=1000)
        self.waiting = []

    def submit(self, work, *args):
        future = super().submit(lambda *_: ([], {}))
        self.waiting.append((work, args))
        if len(self.waiting) == 12:
            for late, its in reversed(self.waiting):
                late(*its)
        return future


def test_order_leaves_no_trace(fly, tmp_path):
    fly("forwards")
    fly("backwards", Backwards())
    assert content(tmp_path / "backwards") == content(tmp_path / "forwards")


@pytest.mark.parametrize("size", [5, 12])
def test_the_number_of_runs_per_file_leaves_no_trace(fly, tmp_path, monkeypatch, size):
    tables = []
    for runs_each in (1, size):
        monkeypatch.setattr("lidar_emu.campaign.run.runs_per_file", lambda *_, each=runs_each: each)
        folder = tmp_path / f"by_{runs_each}"
        fly(folder.name)
        assert len(list((folder / "runs").glob("part-*.parquet"))) == -(-12 // runs_each)
        tables.append([parquet.read_table(folder / name) for name in ("runs", "beams")])
    assert tables[0] == tables[1]


@pytest.mark.slow
def test_processes_leave_no_trace(fly, tmp_path):
    fly("here", runs=40)
    fly("three", LocalPool(3), runs=40)
    assert content(tmp_path / "three") == content(tmp_path / "here")


@pytest.mark.soak
def test_the_death_of_a_process_leaves_no_trace(fly, tmp_path):
    fly("here", runs=40)
    pool, deaths = LocalPool(2), []

    def reported(progress):
        if progress.done == 10:
            victim = multiprocessing.active_children()[0]
            deaths.append(victim.pid)
            victim.kill()

    fly("killed", pool, runs=40, reported=reported)
    assert deaths
    assert content(tmp_path / "killed") == content(tmp_path / "here")


def test_a_run_that_no_process_survives_is_found_and_kept_as_failed(fly, tmp_path):
    def dies(work, args):
        batch = args[1]
        if work is fly_batch:
            return 7 in set(batch.runs) - batch.crashing
        return batch["wire.unit"] == crashing_unit

    fly("well")
    crashing_unit = runs_of(tmp_path / "well")[7]["wire.unit"]
    fly("ill", Here(slots=4, dies=dies))
    well, ill = runs_of(tmp_path / "well"), runs_of(tmp_path / "ill")
    assert "its process died" in ill[7]["failed"]
    assert [row for row in ill if row["run"] != 7] == [row for row in well if row["run"] != 7]


def test_deaths_without_end_end_the_campaign(fly):
    with pytest.raises(RunError, match="workers died in a row"):
        fly(pool=Here(dies=lambda _work, _args: True))


class Interrupted(Here):
    """Ctrl-C after some batches."""

    def submit(self, work, *args):
        if len(self.flown) == 5:
            raise KeyboardInterrupt
        return super().submit(work, *args)


def test_what_was_interrupted_is_gone_on_with_and_no_run_is_flown_twice(fly, tmp_path):
    whole = fly("whole")
    statistics = repr(fly.counts.statistics())
    assert statistics
    first = Interrupted()
    with pytest.raises(KeyboardInterrupt):
        fly("parts", first)
    (tmp_path / "parts" / "runs" / ".part-00009.parquet.123").write_bytes(b"cut")
    second = fly("parts")
    assert repr(fly.counts.statistics()) == statistics
    assert content(tmp_path / "parts") == content(tmp_path / "whole")
    numbers = Counter(args[1].number for _, args in first.flown + second.flown)
    assert numbers == Counter(range(12)) == Counter(args[1].number for _, args in whole.flown)
    assert fly("parts").flown == []


def test_failed_runs_are_kept_with_their_reason_and_others_do_not_suffer(fly, tmp_path):
    text = SMALL.replace("low: 0.1, high: 0.3", "low: 0.5, high: 1.5")
    reported = []
    fly(text=text, reported=reported.append)
    rows = runs_of(tmp_path / "out")
    out_of_range = [row for row in rows if row["site.surface.reflectance"] > 1]
    assert 0 < len(out_of_range) < 12
    for row in rows:
        expected = "campaign: site.surface.reflectance" if row in out_of_range else "None"
        assert str(row["failed"]).startswith(expected)
        assert (row["shots"] is None) == (row in out_of_range)
    beams = parquet.read_table(tmp_path / "out" / "beams", columns=["run"])["run"].to_pylist()
    assert set(beams) == {row["run"] for row in rows if row not in out_of_range}
    assert reported[-1] == (12, 12, len(out_of_range))
    reasons, statistics = fly.counts.reasons, repr(fly.counts.statistics())
    assert sum(reasons.values()) == len(out_of_range)
    fly(text=text)
    assert (fly.counts.reasons, repr(fly.counts.statistics())) == (reasons, statistics)


def test_kernels_that_workers_do_not_find_are_compiled_by_this_process(campaign_file, monkeypatch):
    prepared = prepare(campaign_file(), [], None)
    assert compile_kernels(prepared, Here(slots=2)) == ROWS
    assert compile_kernels(prepared, Here(dies=lambda work, _: work is warm_up)) == ROWS
    monkeypatch.setattr("lidar_emu.campaign.batch.measure_one_shot", lambda _: report_compilation("kernel"))
    assert warm_up(prepared.first) is None
    assert compile_kernels(prepared, Here()) == ROWS


LOADED = """
import sys
from pathlib import Path
from small_campaign import ROWS, Here
from lidar_emu.campaign.description import prepare
from lidar_emu.campaign.run import fly_campaign
_, counts = fly_campaign(prepare(Path(sys.argv[1]), [], None), ROWS, Path(sys.argv[2]), Here(), print)
assert counts.statistics()
print(*sys.modules)
"""


def test_neither_the_command_nor_its_workers_load_what_takes_long(campaign_file, tmp_path):
    path = campaign_file(SMALL + "sampling: latin_hypercube\n", 2)
    command = [sys.executable, "-c", LOADED, str(path), str(tmp_path / "out")]
    search = os.pathsep.join(sys.path)
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env=os.environ | {"PYTHONPATH": search}
    )
    loaded = set(done.stdout.split())
    assert "pyarrow.parquet" in loaded
    assert loaded.isdisjoint({"pandas", "pyarrow.dataset", "scipy.stats", "matplotlib", "rich"})


def test_only_some_runs_keep_their_beams(fly, tmp_path):
    fly(text=SMALL + "beams_every: 5\n")
    beams = parquet.read_table(tmp_path / "out" / "beams", columns=["run"])["run"].to_pylist()
    assert set(beams) == {0, 5, 10}
    assert len(runs_of(tmp_path / "out")) == 12


def test_another_campaign_does_not_get_into_the_folder(fly):
    fly()
    with pytest.raises(InputError, match=r"holds another campaign \(different: campaign.seed, "):
        fly(text=SMALL.replace("seed: 5", "seed: 6"))
    with pytest.raises(InputError, match=r"holds another campaign \(different: campaign.runs\)"):
        fly(runs=13)


def test_a_folder_with_something_else_is_left_alone(fly, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="holds other files"):
        fly()
    assert content(tmp_path / "out") == {"thesis.tex": b"x"}


def test_one_process_at_a_time(fly, tmp_path):
    fly()
    with (tmp_path / "out" / ".lock").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="is in use"):
            fly()


@pytest.mark.parametrize(
    ("runs", "rows", "every", "expected"),
    [
        (1, 4032, 1, 1),
        (1000, 4032, 1, 3),
        (10**6, 4032, 1, 49),
        (10**6, 4032, 100, 256),
        (10**6, 10**9, 1, 1),
    ],
)
def test_files_are_neither_tiny_nor_huge(campaign_file, runs, rows, every, expected):
    prepared = prepare(campaign_file(SMALL + f"beams_every: {every}\n", 1), [], None)
    many = prepared.campaign.model_copy(update={"runs": runs})
    assert (
        runs_per_file(prepared.__class__(many, prepared.base, prepared.drawn, prepared.first), rows)
        == expected
    )


def test_a_full_disk_is_reported(campaign_file, tmp_path, monkeypatch):
    def full(*_):
        raise RunError("out: could not be written: No space left on device")

    monkeypatch.setattr("lidar_emu.campaign.batch.write_runs", full)
    with pytest.raises(RunError, match="No space left"):
        fly_campaign(prepare(campaign_file(), [], None), ROWS, tmp_path / "out", Here(), lambda _: None)


def test_kept_ground_and_trajectories_are_those_that_would_be_made(campaign_file):
    text = SMALL.replace("site: flat", "timing.rate_hz: 40") + (
        "  site: {{kind: choice, of: [mare, flat, crater_wall]}}\n"
        "  trajectory.waypoints.0.speed_mps: {{kind: choice, of: [90.0, 100.0]}}\n"
    )
    text = text.replace("kind: normal, mean: 900, sigma: 60, low: 800", "kind: choice, of: [2000.0, 1900.0]")
    prepared = prepare(campaign_file(text, 24), [], None)
    for run in range(24):
        values = prepared.drawn.values(run)
        fresh = lidar_emu.simulate(prepared.base.scenario_of(values)).table()
        kept = measure_run(prepared.base, values).table()
        assert all(np.array_equal(kept[name], fresh[name], equal_nan=True) for name in fresh)


@pytest.mark.parametrize("text", ["[" * 100_000, "not JSON", "\0", ""])
def test_a_statement_that_cannot_be_read_is_refused(fly, tmp_path, text):
    fly()
    (tmp_path / "out" / "campaign.json").write_text(text)
    with pytest.raises(InputError, match=r"has a campaign.json that cannot be read"):
        fly()


def test_a_statement_that_is_a_pipe_is_not_waited_for(fly, tmp_path):
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "out" / "campaign.json")
    with pytest.raises(InputError, match="a pipe to which nobody writes"):
        fly()


@pytest.fixture(scope="module")
def whole_tables(tmp_path_factory):
    """Bytes and columns of a table of runs and one of beams."""
    folder = tmp_path_factory.mktemp("tables")
    (folder / "campaign.yaml").write_text(SMALL.format(runs=2))
    prepared = prepare(folder / "campaign.yaml", [], None)
    fly_campaign(prepared, ROWS, folder / "out", Here(), lambda _: None)
    paths = [sorted((folder / "out" / name).iterdir())[0] for name in ("runs", "beams")]
    names = [parquet.ParquetFile(path).schema.names for path in paths]
    return [(path.read_bytes(), read_columns(path, of)) for path, of in zip(paths, names, strict=True)]


@given(
    table=st.integers(0, 1),
    at=st.floats(0, 1, exclude_max=True),
    in_footer=st.booleans(),
    bit=st.integers(0, 7),
)
def test_a_flipped_bit_changes_no_value_in_silence(whole_tables, tmp_path_factory, table, at, in_footer, bit):
    whole, columns = whole_tables[table]
    footer_bytes = 8 + int.from_bytes(whole[-8:-4], "little")
    first = len(whole) - footer_bytes if in_footer else 0
    damaged = bytearray(whole)
    damaged[first + int(at * (len(whole) - first))] ^= 1 << bit
    path = tmp_path_factory.mktemp("flipped") / "part-00000.parquet"
    path.write_bytes(damaged)
    try:
        found = read_columns(path, list(columns))
    except InputError:
        return
    for name, values in columns.items():
        np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize("table", ["runs", "beams"])
@pytest.mark.parametrize("damage", ["junk", "cut", "folder", "columns", "rows", "types"])
def test_a_damaged_table_is_refused_by_its_name(fly, tmp_path, table, damage):
    fly()
    path = sorted((tmp_path / "out" / table).iterdir())[0]
    whole, known = path.read_bytes(), parquet.read_table(path)
    path.unlink()
    if damage == "folder":
        path.mkdir()
    elif damage == "columns":
        parquet.write_table(pyarrow.table({"other": [1]}), path)
    elif damage == "rows":
        parquet.write_table(known.slice(0, 0), path)
    elif damage == "types":
        nothing = pyarrow.nulls(len(known), pyarrow.null())
        parquet.write_table(pyarrow.table(dict.fromkeys(known.column_names, nothing)), path)
    else:
        path.write_bytes(b"junk" if damage == "junk" else whole[: len(whole) // 2])
    with pytest.raises(InputError, match=f"{path.name}: .*; name a file that lidar-emu campaign wrote"):
        fly()

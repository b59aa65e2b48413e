"""The declared columns, against what is measured, written and sent; and the page that documents them."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

import lidar_emu
from lidar_emu.measurement import COLUMNS, TABLE, Measurement
from lidar_emu.report.exports import export
from lidar_protocol import shipped_interface

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from columns_page import markdown

PAGE = Path(__file__).resolve().parents[2] / "docs" / "columns.md"
UNITS = {
    "m": "m", "mps": "m/s", "mps2": "m/s²", "deg": "deg", "radps": "rad/s", "db": "dB", "s": "s", "ns": "ns"
}  # fmt: skip
NOT_OF_A_MEASUREMENT = {"time_offset_s"}


@pytest.fixture(scope="module", params=["geometric", "spectral"])
def run(request):
    return lidar_emu.simulate(lidar_emu.load("descent", {"level": request.param, "duration_s": "1"}))


def test_the_page_is_current():
    assert PAGE.read_text() == markdown(), "run: make docs"


def test_units_are_those_of_the_names():
    for name, column in {**TABLE, **COLUMNS}.items():
        assert UNITS.get(name.rsplit("_", 1)[-1], "") == column.unit, name


def test_arrays_have_the_declared_type_and_shape(run):
    shots, beams = run.fired.shape
    for name, column in COLUMNS.items():
        values = getattr(run, name)
        leading = (shots,) if column.per_shot else (shots, beams)
        assert (values.dtype, values.shape) == (np.dtype(column.dtype), (*leading, *column.components)), name


def test_columns_of_a_table_have_the_declared_type(run):
    assert {name: column.dtype.str[-2:].strip("|") for name, column in run.table().items()} == {
        name: {"?": "b1"}.get(column.dtype, column.dtype) for name, column in TABLE.items()
    }


def test_a_file_has_the_columns_of_the_page_in_order(run, tmp_path):
    export([run], tmp_path / "run.csv")
    with (tmp_path / "run.csv").open() as file:
        header = next(csv.reader(file))
    listed = [line.split("|")[1:6] for line in markdown().splitlines() if line.startswith("| `")]
    assert header == [cells[0].strip(" `") for cells in listed if cells[4].strip() == "yes"]


def test_packets_carry_the_columns_that_the_page_reports():
    sent = {placed.field.name for placed in shipped_interface("default").packet.beam.placed}
    listed = [[cell.strip(" `") for cell in line.split("|")] for line in markdown().splitlines()]
    assert {
        cells[1] for cells in listed if len(cells) > 7 and cells[7] == "yes"
    } == sent - NOT_OF_A_MEASUREMENT


def test_columns_that_are_not_given_are_missing():
    shot = np.arange(3)
    time_ns = np.zeros((3, 2), dtype=np.int64)
    run = Measurement.with_columns(shot, time_ns, shot, range_m=np.ones((3, 2)))
    assert run.range_m.sum() == 6
    assert np.isnan(run.point_site_m).all()
    assert run.point_site_m.shape == (3, 2, 3)
    assert run.position_site_m.shape == (3, 3)
    assert not run.fired.any()
    assert not run.segments.any()
    assert (run.reason == 1).all()  # not fired, as on the wire

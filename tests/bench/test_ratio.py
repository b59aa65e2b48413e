"""`lidar-emu bench ... --at-least`: the printed ratio, the bound, and what cannot be measured."""

from __future__ import annotations

import json
from importlib import import_module

import pytest
from click.testing import CliRunner, Result

from lidar_emu.bench.protocol import Cost
from lidar_emu.bench.spectra import SpectrumMethod, ratio_to_published
from lidar_emu.cli import cli
from lidar_emu.cli.bench import bench
from lidar_emu.cli.bench.ratio import judge
from lidar_emu.cli.bench.realtime import ratio_of_medians
from lidar_emu.errors import InputError, RunError

COSTS = [Cost("packet, built", 2e-6, 1e-3), Cost("packet, decoded", 1e-3, 1e-3)]


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(import_module("lidar_emu.bench.protocol"), "measure_protocol", lambda _: COSTS)


def bench_protocol(*options: str) -> Result:
    return CliRunner().invoke(cli, ["bench", "protocol", *options], standalone_mode=False)


@pytest.mark.usefixtures("measured")
def test_the_ratio_is_printed_beside_what_a_program_reads() -> None:
    run = bench_protocol("--json", "--at-least", "500")
    assert run.exception is None
    assert [cost["name"] for cost in json.loads(run.stdout)] == [cost.name for cost in COSTS]
    assert run.stderr == "ratio: 500 (time of the slow exact path to ours, packet, built)\n"


@pytest.mark.usefixtures("measured")
def test_below_the_bound_the_table_is_printed_and_the_command_fails() -> None:
    run = bench_protocol("--at-least", "501")
    assert "packet, decoded" in run.stdout
    assert isinstance(run.exception, RunError)
    assert str(run.exception).startswith("--at-least 501: the ratio is 500: ")


@pytest.mark.parametrize("bound", ["nan", "0", "-1", "inf", "ten", ""])
@pytest.mark.parametrize("name", list(bench.commands))
def test_no_bench_measures_before_it_has_read_the_bound(name: str, bound: str) -> None:
    run = CliRunner().invoke(cli, ["bench", name, "--at-least", bound], standalone_mode=False)
    assert isinstance(run.exception, InputError)
    assert "must be a number above 0" in str(run.exception)


def test_without_a_peer_only_a_bound_fails(capsys: pytest.CaptureFixture[str]) -> None:
    judge(None, "time of a peer to ours", None)
    assert capsys.readouterr().err == ""
    with pytest.raises(RunError, match="--at-least 2: not measured: time of a peer"):
        judge(None, "time of a peer to ours", 2.0)


def test_a_ratio_that_is_no_number_reaches_no_bound() -> None:
    with pytest.raises(RunError):
        judge(float("nan"), "time of a peer to ours", 0.1)


def test_medians_of_nothing_have_no_ratio() -> None:
    assert ratio_of_medians({"p50_ns": None}, {"p50_ns": 20}) is None
    assert ratio_of_medians({"p50_ns": 10}, {"p50_ns": None}) is None
    assert ratio_of_medians({"p50_ns": 10}, {"p50_ns": 40}) == 0.25


def test_spectra_are_compared_with_the_fastest_that_was_published() -> None:
    methods = [
        SpectrumMethod("samples and FFT", 1.0, 0.0),
        SpectrumMethod("published, nearest, 2048 points", 3e-5, 1e-3),
        SpectrumMethod("published, cubic, 2048 points", 2e-5, 1e-3),
        SpectrumMethod("bin by bin", 1e-6, 1e-9),
    ]
    assert ratio_to_published(methods) == pytest.approx(20.0)
    assert ratio_to_published([methods[0], methods[-1]]) is None

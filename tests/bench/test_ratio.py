"""`lidar-emu bench ... --at-least`: the printed ratio, the bound, and what cannot be measured."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.cli.bench.ratio import judge
from lidar_emu.cli.bench.realtime import ratio_of_medians
from lidar_emu.errors import InputError, RunError


def test_the_ratio_is_printed_beside_what_a_program_reads(capsys: pytest.CaptureFixture[str]) -> None:
    judge(500.0, "time of a peer to ours", 500.0)
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", "ratio: 500 (time of a peer to ours)\n")


def test_below_the_bound_the_ratio_is_printed_and_the_command_fails(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(RunError, match=r"--at-least 501: the ratio is 500: time of a peer to ours"):
        judge(500.0, "time of a peer to ours", 501.0)
    assert capsys.readouterr().err == "ratio: 500 (time of a peer to ours)\n"


@pytest.mark.parametrize("bound", ["nan", "0", "-1", "inf", "ten", ""])
@pytest.mark.parametrize("name", ["realtime", "response"])
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

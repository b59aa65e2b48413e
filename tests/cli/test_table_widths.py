"""Tables fit a terminal of 80 columns, and lose no word there."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime, timedelta

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli, terminal
from lidar_emu.cli.run_lines import Announcer
from lidar_emu.cli.terminal import print_lines

COMMANDS = (
    "detection descent.yaml",
    "hazards hazards --set site=flat",
    "budget powered_descent --at 500 --set instrument=ndl_as_flown",
)
BORDERS = "─━┏┳┓┃┡╇┩│└┴┘"


@pytest.mark.parametrize("command", COMMANDS)
def test_tables_fit_80_columns(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    done = CliRunner().invoke(cli, command.split())
    assert done.exit_code == 0, done.stderr
    lines = done.stdout.splitlines()
    edges = [k for k, line in enumerate(lines) if any(mark in line for mark in BORDERS)]
    table = lines[: edges[-1] + 1]
    assert max(map(len, table)) <= 80
    assert not any("…" in line for line in table)


@pytest.mark.parametrize(
    ("command", "without"), [("plan bench.yaml", "80"), ("detection descent.yaml", "40")]
)
def test_a_terminal_without_width_loses_no_line(
    command: str, without: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A serial terminal may state 0 columns; rich then prints nothing of a table."""

    def shown(columns: str) -> str:
        monkeypatch.setenv("COLUMNS", columns)
        return CliRunner().invoke(cli, command.split()).stdout

    assert shown("0") == shown(without) != ""
    assert shown("1") == shown("40")


@pytest.mark.parametrize("columns", [80, 200])
@pytest.mark.parametrize("scenario", ["descent.yaml", "powered_descent.yaml"])
def test_a_plan_has_a_line_for_each_stage_and_with_v_every_word(
    scenario: str, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    brief, verbose, as_json = (
        CliRunner().invoke(cli, ["plan", scenario, *words]).stdout for words in ([], ["-v"], ["--json"])
    )
    decisions = sorted(json.loads(as_json)["decisions"], key=lambda decision: not decision["computed"])
    lines = [line for line in brief.splitlines() if line.startswith("  ")]
    for line, decision in zip(lines, decisions, strict=True):
        assert line.startswith(f"  {decision['stage']}  ")
    sections = verbose.partition("\n\ncomputing time")[0]
    assert max(map(len, [*lines, *sections.splitlines()])) <= columns
    for decision in decisions:
        how = "" if decision["how"] == "-" else f"{decision['how']} "
        text = f"{decision['stage']} {how}{decision['reason']}; bound: {decision['bound']}"
        assert text in " ".join(sections.split())


def test_a_long_line_of_a_summary_goes_on_below_its_text(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = [
        "",
        "granted    fifo; not: isolated core (" + "isolcpus=managed_irq,domain,1 " * 4 + ")",
        "wire 8",
    ]
    print_lines(lines)
    assert capsys.readouterr().out.splitlines() == lines
    monkeypatch.setattr(terminal, "has_terminal", lambda: True)
    print_lines(lines)
    broken = capsys.readouterr().out
    assert max(map(len, broken.splitlines())) <= 80
    assert re.sub(r"\n {11}(?=\S)", " ", broken).splitlines() == lines


def test_the_lines_that_begin_a_run_fit_80_columns() -> None:
    lines: list[str] = []
    announcer = Announcer("noisy_descent_2025", "lockstep", lines.append)
    announcer.on_waiting("unix:/run/user/1000/lidar.sock", "a host to open it, at most 60 s")
    announcer.on_opened("unix:/run/user/1000/lidar.sock", datetime(2026, 1, 31, tzinfo=UTC))
    assert max(map(len, lines)) <= 80
    assert len(set(lines)) == len(lines) == 3
    assert lines[-1] == "starts at 2026-01-31 00:00:00 UTC; Ctrl-C ends it"


def test_a_start_a_microsecond_before_a_second_is_shown_as_that_second() -> None:
    lines: list[str] = []
    before = datetime(2030, 1, 1, 12, tzinfo=UTC) - timedelta(microseconds=1)
    Announcer("descent", "wall", lines.append).on_opened("in-memory loopback", before)
    assert lines[-1] == "starts at 2030-01-01 12:00:00 UTC; Ctrl-C ends it"

"""Tables fit a terminal of 80 columns, and lose no word there."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli

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

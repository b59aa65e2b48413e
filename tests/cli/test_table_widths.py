"""Tables fit a terminal of 80 columns, and lose no word there."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli

COMMANDS = (
    "detection descent.yaml",
    "hazards hazards --set site=flat",
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


@pytest.mark.parametrize("columns", ["0", "1", "20"])
def test_a_terminal_without_width_loses_no_word(columns: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A serial terminal may state 0 columns."""

    def words(width: str) -> str:
        monkeypatch.setenv("COLUMNS", width)
        printed = CliRunner().invoke(cli, ["plan", "bench.yaml", "-v"]).stdout
        return "".join(sorted(printed.translate(dict.fromkeys(map(ord, BORDERS + "┠─┨╇━ \n")))))

    assert words(columns) == words("200")


def decisions(scenario: str) -> list[dict[str, str | bool]]:
    made = json.loads(CliRunner().invoke(cli, ["plan", scenario, "--json"]).stdout)["decisions"]
    return sorted(made, key=lambda decision: not decision["computed"])


@pytest.mark.parametrize("columns", [80, 200])
@pytest.mark.parametrize("scenario", ["descent.yaml", "powered_descent.yaml"])
def test_a_plan_has_a_line_for_each_stage(
    scenario: str, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = CliRunner().invoke(cli, ["plan", scenario]).stdout.splitlines()
    stages = [line for line in lines if line.startswith("  ")]
    assert max(map(len, stages)) <= columns
    for line, decision in zip(stages, decisions(scenario), strict=True):
        assert line.startswith(f"  {decision['stage']}  ")


@pytest.mark.parametrize("columns", [80, 200])
def test_a_verbose_plan_has_every_word(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    shown = CliRunner().invoke(cli, ["plan", "powered_descent.yaml", "-v"]).stdout
    sections, _ = shown.split("\n\ncomputing time")
    assert max(map(len, sections.splitlines())) <= columns
    words, texts = " ".join(sections.split()), []
    for decision in decisions("powered_descent.yaml"):
        how = f"{decision['how']} " if decision["how"] != "-" else ""
        texts.append(f"{decision['stage']} {how}{decision['reason']}; bound: {decision['bound']}")
    assert all(" ".join(text.split()) in words for text in texts)

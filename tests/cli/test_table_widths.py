"""Tables fit a terminal of 80 columns, and lose no word there."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli

COMMANDS = (
    "plan descent.yaml",
    "plan powered_descent.yaml",
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
    """A serial terminal may state 0 columns; rich then prints nothing of the table."""

    def words(width: str) -> str:
        monkeypatch.setenv("COLUMNS", width)
        printed = CliRunner().invoke(cli, ["plan", "bench.yaml"]).stdout
        return "".join(sorted(printed.translate(dict.fromkeys(map(ord, BORDERS + "┠─┨╇━ \n")))))

    assert words(columns) == words("200")

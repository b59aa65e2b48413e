"""`lidar-emu bench stability`: what an instrument reports at the extremes of its keys and of its flight."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import load_scenario, settings_option
from lidar_emu.cli.terminal import print_line, print_note, show_step
from lidar_emu.errors import RunError

if TYPE_CHECKING:
    from rich.table import Table

_LEVELS = "geometric", "spectral", "reference"


@click.command(short_help="What an instrument reports at the extremes of its keys and of its flight.")
@click.argument("scenario", default="descent.yaml")
@settings_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def stability(scenario: str, settings: tuple[str, ...], as_json: bool) -> None:
    """Fly the instrument of SCENARIO (descent.yaml) at extremes: what is refused, what fails, how far errors grow.

    Speeds, heights, slopes, turns, wide lines and ten days over level ground, with the scenario's beams, surface and
    air, at every level; and the least and the largest value of each number of the instrument, at levels geometric and
    spectral. Errors are against the ground truth, speeds modulo λ fs/2, of valid beams; where
    signs are resolved, of these alone. Degraded: twice the error on level ground, or 5 % fewer valid beams.
    Exit code 1: a value is valid and no number, infinite or negative, or the model fails.
    Takes about a minute; Ctrl-C prints what was measured so far.

    \b
    lidar-emu bench stability
    lidar-emu bench stability my.yaml
    lidar-emu bench stability --set instrument=ndl_fine --json
    """
    flown = load_scenario(scenario, None, None, settings)
    from lidar_emu.bench.stability import measure_stability
    from lidar_emu.scenario.load import require_flight

    rows: list[dict[str, Any]] = []
    interrupted = False
    try:
        rows.extend(measure_stability(require_flight(flown), show_step))
    except KeyboardInterrupt:
        interrupted = True
    show_step("")
    if as_json:
        found = {"scenario": flown.name, "interrupted": interrupted, "extremes": rows}
        print_line(json.dumps(found, indent=2))
    elif rows:
        _print(flown.name, rows)
    if interrupted:
        print_note(f"interrupted after {len(rows)} extremes")
    unsound = [
        f"{row['extreme']}, {level}: {text}"
        for row in rows
        for level, found in row["levels"].items()
        for text in found["unsound"]
    ]
    if unsound:
        raise RunError("; ".join(unsound))


def _print(name: str, rows: list[dict[str, Any]]) -> None:
    from lidar_emu.cli.plain_console import PlainConsole

    console = PlainConsole()
    console.print(_table(name, rows))
    usual = rows[0]["levels"]
    for row in rows:
        for level, found in row["levels"].items():
            if found["refused"] and (row is rows[0] or not usual[level]["refused"]):
                where = f" at {level}" if row is rows[0] else ""
                line = f"refused{where}: {row['extreme']}: {found['refused']}"
                console.print_lines(line)
                break
    counts = Counter(row["levels"]["spectral"]["verdict"] for row in rows[1:])
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.most_common())
    console.print(f"{len(rows) - 1} extremes, at level spectral: {verdicts}")


def _table(name: str, rows: list[dict[str, Any]]) -> Table:
    from lidar_emu.cli.plain_console import plain_table

    title = f"{name}: valid beams and errors at levels geometric/spectral/reference"
    headings = "valid %\ng/s/r", "range rms m\ns/r", "speed rms mm/s\ns/r"
    table = plain_table("extreme", *headings, title=title, texts=1)
    table.padding = (0, 1, 0, 0)
    for row in rows:
        levels = row["levels"]
        if row is not rows[0] and {found["verdict"] for found in levels.values()} <= {"as before", "refused"}:
            continue
        cells = [
            _cell(levels, "valid", 100.0),
            _cell(levels, "range_rms_m"),
            _cell(levels, "speed_rms_mps", 1e3),
        ]
        if levels["spectral"]["verdict"] == "nothing valid":
            reasons = levels["spectral"]["reasons"]
            cells[1] = max(reasons, key=reasons.get, default="no beam fired").replace("_", " ")
        table.add_row(row["extreme"], *cells)
    return table


def _cell(levels: dict[str, dict[str, Any]], key: str, scale: float = 1.0) -> str:
    """A value at each level; level geometric has no errors."""
    values = (levels.get(level, {}).get(key) for level in _LEVELS[key != "valid" :])
    return "/".join("-" if value is None else f"{scale * value:.3g}" for value in values)

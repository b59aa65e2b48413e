"""`lidar-emu plan`: what a run computes, what it leaves out, and why."""

from __future__ import annotations

import json

import click

from lidar_emu.cli.options import load_scenario, scenario_options


@click.command(short_help="What a run computes and what it leaves out, with reasons.")
@scenario_options
@click.option("--json", "as_json", is_flag=True, help="For machines.")
def plan(
    scenario: str,
    duration: str | None,
    seed: str | None,
    settings: tuple[str, ...],
    exact: bool,
    as_json: bool,
) -> None:
    """Show what SCENARIO needs, what is left out, the reason and what it costs at most.

    \b
    lidar-emu plan descent.yaml
    lidar-emu plan my.yaml --json
    """
    from lidar_emu.shots import build_model

    flown = load_scenario(scenario, duration, seed, settings, exact)
    decisions = build_model(flown).plan.decisions
    if as_json:
        from dataclasses import asdict

        click.echo(
            json.dumps({"scenario": flown.name, "decisions": [asdict(d) for d in decisions]}, indent=2)
        )
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"plan of {flown.name}", title_justify="left")
    for column in ("stage", "computed", "how", "reason", "bound"):
        table.add_column(column)
    for d in decisions:
        table.add_row(d.stage, "yes" if d.computed else "left out", d.how, d.reason, d.bound)
    Console().print(table)

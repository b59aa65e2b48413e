"""`lidar-emu plan`: what a run computes and leaves out, with reasons and error bounds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import geometry_option, load_scenario, scenario_options
from lidar_emu.cli.terminal import busy, print_line

if TYPE_CHECKING:
    from lidar_emu.scenario.schema import Scenario, Timing
    from lidar_emu.shots.model import Model


@click.command(short_help="Show what a run computes and leaves out, with reasons.")
@scenario_options
@geometry_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def plan(
    scenario: str,
    duration: str | None,
    seed: str | None,
    settings: tuple[str, ...],
    exact: bool,
    geometry: str | None,
    as_json: bool,
) -> None:
    """Show what a run of SCENARIO computes and leaves out, with the reason and a bound on the error.

    The computing time of a flight follows from that of a block of its shots, on one core of this machine.

    \b
    lidar-emu plan descent.yaml
    lidar-emu plan my.yaml --json
    lidar-emu plan descent.yaml --geometry flight.npz
    """
    from lidar_emu.shots.model import build_model

    flown = load_scenario(scenario, duration, seed, settings, exact)
    model = build_model(flown, None if geometry is None else Path(geometry))
    run_s = _run_s(flown, model)
    decisions = model.plan.decisions
    policies = _policies(flown.timing)
    if as_json:
        from dataclasses import asdict

        document = {
            "scenario": flown.name,
            "decisions": [asdict(d) for d in decisions],
            "computing_time_s": run_s,
            "policies": policies,
        }
        print_line(json.dumps(document, indent=2))
        return
    from rich.table import Table

    from lidar_emu.cli.plain_console import PlainConsole

    table = Table(title=f"plan of {flown.name}", title_justify="left")
    for column in ("stage", "computed", "how", "reason", "bound"):
        table.add_column(column, overflow="fold")
    for d in decisions:
        table.add_row(d.stage, "yes" if d.computed else "left out", d.how, d.reason, d.bound)
    PlainConsole().print(table)
    if run_s is not None:
        share = run_s / (model.shot_count * model.period_ns * 1e-9)
        print_line(f"computing time: {_duration(run_s)} on one core, {share:.2g} of the flight's time")
    print_line("\n".join(f"{key}: {meaning}" for key, meaning in policies.items()))


def _run_s(flown: Scenario, model: Model) -> float | None:
    if model.flight is None or model.flight.is_live:
        return None
    from lidar_emu.runtime.clock import Clock
    from lidar_emu.shots.model import estimate_run_s

    with busy(f"timing shots of {flown.name}"):
        return estimate_run_s(model, Clock().now_ns)


def _duration(time_s: float) -> str:
    for unit, length_s in (("days", 86_400), ("hours", 3600), ("minutes", 60)):
        if time_s >= 2 * length_s:
            return f"{time_s / length_s:.2g} {unit}"
    return f"{time_s:.2g} s"


def _policies(timing: Timing) -> dict[str, str]:
    late = f"a packet that is {timing.late_after_ns * 1e-6:g} ms late "
    when_late = {"skip": f"{late}is skipped", "abort": f"{late}ends the run"}
    dies = "if the model process or the port process dies, the other one "
    when_process_dies = {
        "end": f"{dies}ends the run",
        "safe": f"{dies}sends mode safe, and ends the run",
    }
    return {
        "timing.when_late": when_late[timing.when_late],
        "timing.when_process_dies": when_process_dies[timing.when_process_dies],
    }

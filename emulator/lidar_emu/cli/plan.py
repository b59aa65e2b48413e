"""`lidar-emu plan`: what a run computes and leaves out, with reasons and error bounds."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from shutil import get_terminal_size
from textwrap import shorten, wrap
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import geometry_option, load_scenario, scenario_options
from lidar_emu.cli.terminal import busy, duration_words, print_line

if TYPE_CHECKING:
    from lidar_emu.plan import Decision
    from lidar_emu.scenario.schema import Scenario, Timing
    from lidar_emu.shots.model import Model

_LEAST_COLUMNS = 40
"""A serial terminal may state 0."""


@click.command(short_help="Show what a run computes and leaves out, with reasons.")
@scenario_options
@geometry_option
@click.option("-v", "--verbose", is_flag=True, help="Print reasons and bounds, and no shortened lines.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def plan(
    scenario: str,
    duration: str | None,
    seed: str | None,
    settings: tuple[str, ...],
    exact: bool,
    geometry: str | None,
    verbose: bool,
    as_json: bool,
) -> None:
    """Show what a run of SCENARIO computes and leaves out, with the reason and a bound on the error.

    The computing time of a flight follows from that of a block of its shots, on one core of this machine.

    \b
    lidar-emu plan descent.yaml
    lidar-emu plan descent.yaml -v
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
        document = {
            "scenario": flown.name,
            "decisions": model.plan.rows(),
            "computing_time_s": run_s,
            "policies": policies,
        }
        print_line(json.dumps(document, indent=2))
        return
    hint = "" if verbose else " (-v: reasons and bounds)"
    print_line("\n".join([f"plan of {flown.name}{hint}", *_sections(decisions, verbose), ""]))
    if run_s is not None:
        share = run_s / (model.shot_count * model.period_ns * 1e-9)
        print_line(f"computing time: {duration_words(run_s)} on one core, {share:.2g} of the flight's time")
    print_line("\n".join(f"{key}: {meaning}" for key, meaning in policies.items()))


def _sections(decisions: Sequence[Decision], verbose: bool) -> Iterator[str]:
    """A line for each stage that is computed, then for each that is left out; with `verbose`, all about it."""
    indent = 4 + max(len(decision.stage) for decision in decisions)
    room = max(_LEAST_COLUMNS, get_terminal_size().columns) - indent
    for computed, heading in ((True, "computed"), (False, "left out: effect at most, or why there is none")):
        chosen = [decision for decision in decisions if decision.computed is computed]
        yield from ["", heading] if chosen else []
        for decision in chosen:
            texts = [decision.how] if decision.how != "-" else []
            texts.append(f"{decision.reason}; bound: {decision.limits}")
            lines = [line for text in texts for line in wrap(text, room)]
            if not verbose:
                left_out = decision.reason if decision.bound == "exact" else decision.limits
                lines = [shorten(decision.how if computed else left_out, room, placeholder=" ...")]
            yield f"  {decision.stage}".ljust(indent) + lines[0]
            yield from (" " * indent + line for line in lines[1:])


def _run_s(flown: Scenario, model: Model) -> float | None:
    if model.flight is None or model.flight.is_live:
        return None
    from lidar_emu.runtime.clock import Clock
    from lidar_emu.shots.model import estimate_run_s

    with busy(f"timing shots of {flown.name}"):
        return estimate_run_s(model, Clock().now_ns)


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

"""`lidar-emu bench protocol`: the cost of packets and frames."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.bench.ratio import at_least_option, judge
from lidar_emu.cli.output import print_line

if TYPE_CHECKING:
    from lidar_emu.bench.protocol import Cost

_ROUNDS = 200


@click.command(short_help="Cost of packets, CAN frames and CRCs, compared with a slow exact path.")
@at_least_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def protocol(as_json: bool, at_least: float | None) -> None:
    """Encode and decode a shot of four beams, every field of it, with the default interface.

    Medians of alternating calls. The slow path goes through the definition field by field, in exact fractions, and
    computes CRCs bit by bit; the tests check that both give the same result. The ratio is that of the
    slow path's time to ours for building a packet.

    \b
    lidar-emu bench protocol
    lidar-emu bench protocol --json
    lidar-emu bench protocol --at-least 10
    """
    from lidar_emu.bench.protocol import measure_protocol

    costs = measure_protocol(_ROUNDS)
    if as_json:
        print_line(json.dumps([cost._asdict() for cost in costs], indent=2))
    else:
        _print(costs)
    built = costs[0]
    judge(built.exact_s / built.time_s, f"time of the slow exact path to ours, {built.name}", at_least)


def _print(costs: list[Cost]) -> None:
    print_line(f"{'':30}{'us':>8}{'times faster than field by field':>36}")
    for cost in costs:
        print_line(f"{cost.name:30}{cost.time_s * 1e6:8.2f}{cost.exact_s / cost.time_s:36.0f}")

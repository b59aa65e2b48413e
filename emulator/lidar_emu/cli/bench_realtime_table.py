"""The report of `lidar-emu bench realtime` as tables."""

from __future__ import annotations

import math
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

_FIGURES = {"p50_ns": "p50", "p99_ns": "p99", "p99_9_ns": "p99.9", "max_ns": "max"}
_STAGES = {"wake_up": "woken up", "due_to_written": "written", "due_to_received": "received"}
_BAR_COLUMNS = 24
_COLUMN = 8 + 1 + _BAR_COLUMNS + 2


def print_realtime(told: dict[str, Any]) -> None:
    """Figures, seconds, histogram, and what the machine gave."""
    console = Console()
    console.print(
        f"{told['rate_hz']:g} shots/s of {told['packet_bytes']} bytes, four beams of {told['beamlets']} beamlets"
        f"{', recorded' if told['recording'] else ''}",
        highlight=False,
        soft_wrap=True,
    )
    console.print(_figures_table(told))
    for line in (*_judgement(told), *_machine(told), "", *_histogram_lines(told["histogram"])):
        console.print(line, highlight=False, soft_wrap=True)
    if told["interrupted"]:
        console.print("the flight was interrupted")


def print_response(told: dict[str, Any]) -> None:
    """Figures of `bench response`."""
    console = Console()
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("us from truth sent to last byte written")
    for heading in ("shots", *_FIGURES.values()):
        table.add_column(heading, justify="right")
    for side in ("emulator", "control"):
        table.add_row(side, *_cells(told[side]))
    console.print(table)
    shots = told["shots"]
    console.print(
        f"{told['rate_hz']:g} shots/s, four beams of {told['beamlets']} beamlets; {shots['sent']} sent, "
        f"{shots['late']} late; host steal {told['steal_ticks']} ticks",
        highlight=False,
        soft_wrap=True,
    )


def _figures_table(told: dict[str, Any]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("us after they were due")
    for heading in ("shots", *_FIGURES.values()):
        table.add_column(heading, justify="right")
    for side in ("emulator", "control"):
        for stage, name in _STAGES.items():
            table.add_row(f"{side}, {name}", *_cells(told[side][stage]))
        table.add_section()
    if told["cyclictest"] is not None:
        table.add_row("cyclictest, woken up", *_cells(told["cyclictest"]))
    return table


def _cells(figures: dict[str, int | None]) -> list[str]:
    return [str(figures["count"]), *(_us(figures[name]) for name in _FIGURES)]


def _us(nanoseconds: float | None) -> str:
    return "-" if nanoseconds is None else f"{nanoseconds / 1e3:.0f}"


def _judgement(told: dict[str, Any]) -> list[str]:
    windows, emulator, control = told["windows"], told["emulator"], told["control"]
    return [
        f"seconds    {windows['count']}: p99 due to written is {_us(windows['median_excess_p99_ns'])} us above the "
        "control's (median over them)",
        f"late       {emulator['late']} of {emulator['due']} (control {control['late']}), "
        f"{windows['late_where_control_had_none']} of them in seconds in which the control had none; "
        f"{emulator['dropped']} dropped",
    ]


def _machine(told: dict[str, Any]) -> list[str]:
    steal = "not counted here" if told["steal_ticks"] is None else f"{told['steal_ticks']} ticks of 10 ms"
    machine = told["machine"]
    lines = [
        f"machine    {machine['cores']} cores, Linux {machine['kernel']}; taken away by its host: {steal}",
        f"granted    {', '.join(told['granted']).replace('_', ' ') or 'nothing'}",
    ]
    lines += [f"{'':10} no {name.replace('_', ' ')}; for it: {how}" for name, how in told["missing"].items()]
    if told["cyclictest"] is None:
        lines.append(f"{'':10} no cyclictest beside it; for it: apt install rt-tests")
    return lines


def _histogram_lines(histogram: dict[str, list[int]]) -> list[str]:
    """A line for each bucket, with bars of logarithmic length."""
    sides = [histogram["emulator"], histogram["control"]]
    most = max((*sides[0], *sides[1], 2))
    lines = [f"{'due to written':>16}  {'emulator':<{_COLUMN}}control"]
    for edge, *counts in zip(histogram["edges_ns"], *sides, strict=False):
        cells = "".join(f"{count:>8} {_bar(count, most):<{_BAR_COLUMNS + 2}}" for count in counts)
        lines.append(f"{'from ' + _us(edge) + ' us':>16}{cells}".rstrip())
    return lines


def _bar(count: int, most: int) -> str:
    return "#" * math.ceil(_BAR_COLUMNS * math.log(count + 1) / math.log(most + 1)) if count else ""

"""Table and figure of docs/evidence/timing.md: `lidar-emu bench realtime` at three rates, on an idle machine."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.tables import DOCS, Part

PICTURE = DOCS / "how-late.png"
LIDAR_EMU = [sys.executable, "-c", "from lidar_emu.cli import main; main()"]


class Case(NamedTuple):
    """One flight of the table."""

    rate_hz: int
    duration_s: float
    recorded: bool


CASES = (Case(1111, 60, False), Case(100, 600, True), Case(20, 600, True))


def measure(case: Case, picture: Path | None) -> dict[str, Any]:
    """Results of `lidar-emu bench realtime` for a case, as printed by --json."""
    options = ["--rate", str(case.rate_hz), "--duration", str(case.duration_s), "--json"]
    options += ["--record"] if case.recorded else []
    options += ["--plot", str(picture)] if picture else []
    done = subprocess.run([*LIDAR_EMU, "bench", "realtime", *options], stdout=subprocess.PIPE, check=True)
    results: dict[str, Any] = json.loads(done.stdout)
    return results


def parts() -> Iterator[Part]:
    """Measure all cases: the machine and the table."""
    results = [measure(case, None if k else PICTURE) for k, case in enumerate(CASES)]
    first = results[0]
    machine = first["machine"]
    yield (
        f"Measured {datetime.now(UTC):%Y-%m-%d} on {machine['cores']} cores, Linux {machine['kernel']}, "
        f"Python {machine['python']}, granted {', '.join(first['granted']).replace('_', ' ') or 'nothing'}; "
        "microseconds (p50 / p99 / p99.9 / max):"
    )
    yield (
        "shots/s, time", "side", "woken up", "due to written", "due to received", "late",
        "p99 above the control's", "late where it had none", "host steal",
    )  # fmt: skip
    for result in results:
        yield from rows(result)


def rows(result: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """Two rows of the table: emulator and control process."""
    name = f"{result['rate_hz']:g}, {result['duration_s']:g} s{', recorded' if result['recording'] else ''}"
    windows, ticks = result["windows"], result["steal_ticks"]
    excess = windows["median_excess_p99_ns"]
    judgement = (
        "-" if excess is None else f"**{excess / 1e3:.0f} us**",
        str(windows["late_where_control_had_none"]),
        "-" if ticks is None else f"{10 * ticks} ms",
    )
    for side, label, end in (("emulator", name, judgement), ("control", "", ("", "", ""))):
        stages = [figures(result[side][stage]) for stage in ("wake_up", "due_to_written", "due_to_received")]
        yield label, side, *stages, f"{result[side]['late']} of {result[side]['due']}", *end


def figures(quantiles: dict[str, int | None]) -> str:
    """Quantiles in microseconds: p50 / p99 / p99.9 / max."""
    values = (quantiles[name] for name in ("p50_ns", "p99_ns", "p99_9_ns", "max_ns"))
    return " / ".join("-" if value is None else f"{value / 1e3:.0f}" for value in values)

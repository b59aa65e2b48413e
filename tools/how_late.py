"""Update the table of docs/evidence/timing.md between its two markers, and its figure.

python tools/how_late.py            on an otherwise idle machine; takes 21 minutes
python tools/how_late.py --quick    a tenth of the time, to check that it works
"""

from __future__ import annotations

import json
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

PAGE = Path(__file__).resolve().parents[1] / "docs" / "evidence" / "timing.md"
PICTURE = PAGE.with_suffix(".png")
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
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


def page_text(results: list[dict[str, Any]]) -> str:
    """The part of the page between the markers."""
    first, lines = results[0], []
    machine = first["machine"]
    lines.append(
        f"Measured {datetime.now(UTC):%Y-%m-%d} on {machine['cores']} cores, Linux {machine['kernel']}, "
        f"Python {machine['python']}, granted {', '.join(first['granted']).replace('_', ' ') or 'nothing'}; "
        "microseconds (p50 / p99 / p99.9 / max):\n"
    )
    lines.append(
        "| shots/s, time | side | woken up | due to written | due to received | late | p99 above the control's "
        "| late where it had none | host steal |"
    )
    lines.append("|---|---|---|---|---|---|---|---|---|")
    for result in results:
        lines += rows(result)
    if first["cyclictest"] is not None:
        lines.append(f"\ncyclictest beside the first: {figures(first['cyclictest'])}.")
    return "\n".join(lines)


def rows(result: dict[str, Any]) -> list[str]:
    """Two rows of the table: emulator and control process."""
    name = f"{result['rate_hz']:g}, {result['duration_s']:g} s{', recorded' if result['recording'] else ''}"
    windows, ticks = result["windows"], result["steal_ticks"]
    excess = windows["median_excess_p99_ns"]
    excess_text = "-" if excess is None else f"**{excess / 1e3:.0f} us**"
    steal = "-" if ticks is None else f"{10 * ticks} ms"
    judgement = f"{excess_text} | {windows['late_where_control_had_none']} | {steal}"
    lines = []
    for side, label, end in (("emulator", name, judgement), ("control", "", " | | ")):
        stages = " | ".join(
            figures(result[side][stage]) for stage in ("wake_up", "due_to_written", "due_to_received")
        )
        lines.append(
            f"| {label} | {side} | {stages} | {result[side]['late']} of {result[side]['due']} | {end} |"
        )
    return lines


def figures(quantiles: dict[str, int | None]) -> str:
    """Quantiles in microseconds: p50 / p99 / p99.9 / max."""
    values = (quantiles[name] for name in ("p50_ns", "p99_ns", "p99_9_ns", "max_ns"))
    return " / ".join("-" if value is None else f"{value / 1e3:.0f}" for value in values)


def main() -> None:
    """Measure all cases, and rewrite the page."""
    shorter = 0.1 if "--quick" in sys.argv[1:] else 1.0
    results: list[dict[str, Any]] = []
    for case in CASES:
        shown = case._replace(duration_s=case.duration_s * shorter)
        print(f"{shown.rate_hz} shots/s, {shown.duration_s:g} s", file=sys.stderr)
        results.append(measure(shown, None if results else PICTURE))
    text = PAGE.read_text()
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(f"{before}{BEGIN}\n{page_text(results)}\n{END}{after}")


if __name__ == "__main__":
    main()

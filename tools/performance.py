"""Measure where users wait, and update the tables of docs/evidence/performance.md between their markers.

python tools/performance.py                        `make performance`: half an hour on an otherwise idle machine
python tools/performance.py growth                 only these tables: ratios, starts, growth
python tools/performance.py --ratios FILE.json     only the ratios, of short runs, into a file; the page is left alone
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from shot_costs import BEAMLETS, BEAMS, ground_costs, shot_costs

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "evidence" / "performance.md"
LIDAR_EMU = [sys.executable, "-m", "lidar_emu"]
Row = tuple[str, ...]

BENCHES: dict[str, tuple[list[str], list[str]]] = {
    "accuracy": ([], ["--shots", "10"]),
    "campaign": ([], ["--runs", "20"]),
    "casting": ([], []),
    "protocol": ([], []),
    "realtime": (["--duration", "60"], ["--duration", "3"]),
    "response": (["--duration", "60"], ["--duration", "3"]),
}
"""Options of each `bench` command, and those of a short run."""


def bench_ratios(short: bool) -> Iterator[tuple[str, float | None, str]]:
    """Name, ratio and what is compared with what, of each `bench` command; None: its peer is not installed."""
    for name, options in BENCHES.items():
        command = [*LIDAR_EMU, "bench", name, *options[short]]
        run = subprocess.run(command, capture_output=True, text=True, check=True)
        found = re.search(r"^ratio: (\S+) \((.*)\)$", run.stderr, re.MULTILINE)
        ratio, of = (None, "its peer is not installed") if found is None else (float(found[1]), found[2])
        print(name, ratio, of, flush=True)
        yield name, ratio, of


def ratio_rows() -> Iterable[Row]:
    """Table of the ratios."""
    yield "`bench` command", "ratio", "of what to what"
    for name, ratio, of in bench_ratios(short=False):
        yield name, "-" if ratio is None else f"{ratio:.3g}", of


def start_rows() -> Iterable[Row]:
    """Table of starts: a run of one packet, from the command to its end."""
    yield "start", "seconds", "processor seconds", "MB"
    with tempfile.TemporaryDirectory() as folder:
        wheel = _wheel_scripts(Path(folder))
        one_packet = ["run", "descent.yaml", "--pace", "max", "--duration", "0.05"]
        home = {"HOME": folder, "PATH": os.environ["PATH"]}
        clone = [*LIDAR_EMU, *one_packet]
        cache = home | {"NUMBA_CACHE_DIR": str(Path(folder) / "cache")}
        yield "clone, first: kernels are compiled", *_start(clone, cache, 1)
        yield "clone, later", *_start(clone, cache, 5)
        if wheel is None:
            return
        installed = [str(wheel / "lidar-emu"), *one_packet]
        yield (
            "wheel of `make wheel`, first, in an empty home without a compiler",
            *_start(installed, {"HOME": folder, "PATH": str(wheel)}, 1),
        )
        yield "wheel, later", *_start(installed, home, 5)
        yield "`lidar-emu --help`", *_start([str(wheel / "lidar-emu"), "--help"], home, 5)


class Taken(NamedTuple):
    """What a command takes, its processes included."""

    wall_s: float
    processor_s: float
    memory_mb: float


_TIMER = """
import os, subprocess, sys, time
begun = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(time.perf_counter() - begun, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)
sys.exit(status != 0)
"""


def taken(command: list[str], environment: dict[str, str] | None = None) -> Taken:
    """Run a command from a small process and measure it: peak memory includes what a child inherits from its parent."""
    timer = [sys.executable, "-S", "-c", _TIMER, *command]
    run = subprocess.run(timer, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return Taken(*map(float, run.stdout.split()))


def _start(command: list[str], environment: dict[str, str], times: int) -> Row:
    """Least figures of a command."""
    figures = [taken(command, environment) for _ in range(times)]
    least = Taken(*(min(column) for column in zip(*figures, strict=True)))
    return f"{least.wall_s:.2f}", f"{least.processor_s:.2f}", f"{least.memory_mb:.0f}"


def _wheel_scripts(folder: Path) -> Path | None:
    """Scripts of an environment with the wheel of dist/, which sees the dependencies of this one."""
    wheels = sorted(
        (ROOT / "dist").glob("lidar_emu-*linux_x86_64.whl"), key=lambda path: path.stat().st_mtime
    )
    if not wheels:
        print("no wheel in dist/: make wheel")
        return None
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    from wheels import install

    return install(wheels[-1], folder / "environment")


def growth_rows() -> Iterable[Row]:
    """Table of the costs of shots by beamlets and beams, and of the ground by cells."""
    yield "", "one shot alone, us", "its packet, us", "a beam in a block of 128 shots, us"
    cases = [(beamlets, 4) for beamlets in BEAMLETS] + [(19, beams) for beams in BEAMS if beams != 4]
    for (beamlets, beams), cost in zip(cases, shot_costs(cases), strict=True):
        alone, packet, beam = 1e6 * cost.alone_s, 1e6 * cost.packet_s, 1e6 * cost.beam_s
        yield f"{beams} beams of {beamlets} beamlets", f"{alone:.0f}", f"{packet:.0f}", f"{beam:.1f}"


def ground_rows() -> Iterable[Row]:
    """Table of the costs of a grid by cells."""
    yield "cells of a grid", "ready in, ms", "4 beams of 61 beamlets, us"
    for cells, ready_s, cast_s in ground_costs():
        yield f"{cells:,}".replace(",", " "), f"{1e3 * ready_s:.1f}", f"{1e6 * cast_s:.1f}"


def campaign_rows() -> Iterable[Row]:
    """Table of campaigns by runs."""
    yield "runs of `dispersed_descent.yaml`, statistical", "seconds", "MB"
    for runs in (50, 200, 800):
        with tempfile.TemporaryDirectory() as folder:
            options = ["--set", "level=statistical", "--runs", str(runs), "--out", f"{folder}/out"]
            yield str(runs), *_cells([*LIDAR_EMU, "campaign", "dispersed_descent.yaml", *options])


def report_rows() -> Iterable[Row]:
    """Table of reports by hours of a recording."""
    yield "hours at 100 Hz, four beams", "recording, MB", "report, s", "MB", "with its page, s", "MB"
    for hours in (0.125, 0.25, 0.5, 1.0):
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "run.mcap"
            leg = f"speed_mps: {900 / (3600 * hours)}"
            path = f"trajectory.waypoints=[{{altitude_m: 1500, {leg}}}, {{altitude_m: 600, {leg}}}]"
            fly = [*LIDAR_EMU, "run", "descent.yaml", "--pace", "max", "--record", str(recording)]
            taken([*fly, "--set", "timing.rate_hz=100", "--set", path])
            report = [*LIDAR_EMU, "report", str(recording)]
            size_mb = recording.stat().st_size / 1e6
            page = ["--html", str(Path(folder) / "page.html")]
            yield f"{hours:g}", f"{size_mb:.0f}", *_cells(report), *_cells([*report, *page])


def _cells(command: list[str]) -> Row:
    wall_s, _, memory_mb = taken(command)
    return f"{wall_s:.1f}", f"{memory_mb:.0f}"


TABLES: dict[str, list[Callable[[], Iterable[Row]]]] = {
    "ratios": [ratio_rows],
    "starts": [start_rows],
    "growth": [growth_rows, ground_rows, campaign_rows, report_rows],
}
"""What stands between the markers of the page."""


def update(name: str) -> None:
    """Measure the tables between two markers of the page."""
    parts = []
    for rows in TABLES[name]:
        lines = []
        for row in rows():
            lines.append(f"| {' | '.join(row)} |")
            print(lines[-1], flush=True)
        lines.insert(1, "|" + "---|" * lines[0].count(" | ") + "---|")
        parts.append("\n".join(lines))
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, rest = PAGE.read_text().split(begin)
    _, after = rest.split(end)
    parts.append(f"Measured {datetime.now(UTC).date()} on {_machine()}.")
    PAGE.write_text("\n".join([before + begin, "\n\n".join(parts), end + after]))


def _machine() -> str:
    models = re.findall(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    processor = models[0] if models else platform.machine()
    return f"{os.cpu_count()} cores of {processor}, Linux {platform.release()}, Python {platform.python_version()}"


def write_ratios(path: Path) -> None:
    """Write the ratios of short runs to a file."""
    ratios: dict[str, Any] = {
        name: {"ratio": ratio, "of": of} for name, ratio, of in bench_ratios(short=True)
    }
    document = {"date": str(datetime.now(UTC).date()), "machine": _machine(), "ratios": ratios}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=2) + "\n")


def main() -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"{', '.join(TABLES)}; all of them")
    parser.add_argument("--ratios", metavar="FILE.json", type=Path)
    options = parser.parse_args()
    if unknown := set(options.tables) - set(TABLES):
        parser.error(f"no table {', '.join(sorted(unknown))}; must be {', '.join(TABLES)}")
    if options.ratios is not None:
        write_ratios(options.ratios)
        return
    for name in options.tables or TABLES:
        update(name)


if __name__ == "__main__":
    main()

"""Tables of docs/evidence/performance.md: ratios to peers, starts, and how costs grow.

python -m benchmarks.performance FILE.json    writes the ratios of short runs to a file, for a person to compare
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from benchmarks.shot_costs import BEAMLETS, BEAMS, ground_costs, shot_costs
from benchmarks.tables import Part, command_line, machine

ROOT = Path(__file__).resolve().parents[1]
LIDAR_EMU = [sys.executable, "-m", "lidar_emu"]
Row = tuple[str, ...]

BENCHES: dict[str, tuple[list[str], list[str], list[str]]] = {
    "spectra": (["benchmarks.spectra"], [], []),
    "campaign": (["benchmarks.campaign"], [], ["--runs", "8"]),
    "casting": (["benchmarks.casting"], [], []),
    "protocol": (["benchmarks.protocol"], [], []),
    "realtime": (["lidar_emu", "bench", "realtime"], ["--duration", "60"], ["--duration", "3"]),
    "response": (["lidar_emu", "bench", "response"], ["--duration", "60"], ["--duration", "3"]),
}
"""Benchmarks: module, arguments, options, and the options of a short run."""


def bench_ratios(short: bool) -> Iterator[tuple[str, float | None, str]]:
    """Name, ratio and what is compared with what, of each benchmark; None: its peer is not installed."""
    for name, (module, long, brief) in BENCHES.items():
        command = [sys.executable, "-m", *module, *(brief if short else long)]
        run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
        found = re.search(r"^ratio: (\S+) \((.*)\)$", run.stdout + run.stderr, re.MULTILINE)
        ratio, of = (None, "its peer is not installed") if found is None else (float(found[1]), found[2])
        print(name, ratio, of, file=sys.stderr, flush=True)
        yield name, ratio, of


def ratio_parts() -> Iterator[Part]:
    """Table of the ratios."""
    yield "benchmark", "ratio", "of what to what"
    for name, ratio, of in bench_ratios(short=False):
        yield name, "-" if ratio is None else f"{ratio:.3g}", of
    yield machine()


def start_parts() -> Iterator[Part]:
    """Table of starts: a run of one packet, from the command to its end."""
    yield from _starts()
    yield machine()


def growth_parts() -> Iterator[Part]:
    """Tables of the costs of shots, grids, campaigns and reports."""
    for rows in (_shot_rows, _ground_rows, _campaign_rows, _report_rows):
        yield from rows()
        yield ""
    yield machine()


def _starts() -> Iterator[Row]:
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
        print("no wheel in dist/: make wheel", file=sys.stderr)
        return None
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    from wheels import install

    return install(wheels[-1], folder / "environment")


def _shot_rows() -> Iterator[Row]:
    yield "", "one shot alone, us", "its packet, us", "a beam in a block of 128 shots, us"
    cases = [(beamlets, 4) for beamlets in BEAMLETS] + [(19, beams) for beams in BEAMS if beams != 4]
    for (beamlets, beams), cost in zip(cases, shot_costs(cases), strict=True):
        alone, packet, beam = 1e6 * cost.alone_s, 1e6 * cost.packet_s, 1e6 * cost.beam_s
        yield f"{beams} beams of {beamlets} beamlets", f"{alone:.0f}", f"{packet:.0f}", f"{beam:.1f}"


def _ground_rows() -> Iterator[Row]:
    yield "cells of a grid", "ready in, ms", "4 beams of 61 beamlets, us"
    for cells, ready_s, cast_s in ground_costs():
        yield f"{cells:,}".replace(",", " "), f"{1e3 * ready_s:.1f}", f"{1e6 * cast_s:.1f}"


def _campaign_rows() -> Iterator[Row]:
    yield "runs of `dispersed_descent.yaml`", "seconds", "processor seconds", "MB"
    for runs in (2, 50, 200, 800):
        with tempfile.TemporaryDirectory() as folder:
            fly = ["campaign", "dispersed_descent.yaml", "--runs", str(runs), "--out", f"{folder}/out"]
            yield str(runs), *_start([*LIDAR_EMU, *fly], dict(os.environ), 1)


def _report_rows() -> Iterator[Row]:
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


def main(path: Path) -> None:
    """Write the ratios of short runs to a file."""
    ratios = {name: {"ratio": ratio, "of": of} for name, ratio, of in bench_ratios(short=True)}
    document = {"date": str(datetime.now(UTC).date()), "machine": machine(), "ratios": ratios}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    parser = command_line(__doc__)
    parser.add_argument("file", metavar="FILE.json", type=Path)
    main(parser.parse_args().file)

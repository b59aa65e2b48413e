"""Fly with a recording and `listen`, and update a table of docs/evidence/long-runs.md between its two markers.

python tools/soak.py                          an hour in real time
python tools/soak.py --pace max --hours 8     as fast as `listen` reads
python tools/soak.py --hours 0.05             to check that it works; the page is left alone

Exit code 1 if memory, descriptors or threads of a process grew, if a shot was lost on the way, or if the device's clock
ends elsewhere than its closed form.
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
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

PAGE = Path(__file__).resolve().parents[1] / "docs" / "evidence" / "long-runs.md"
LIDAR_EMU = [sys.executable, "-m", "lidar_emu"]
RATE_HZ = 100
SETTLED_MINUTE = 5
"""Until then caches fill and allocators settle."""
ALLOWED_KB = 1024
OFFSET_S = 2**29 - 1000
DRIFT_PPM = 50
CLOCK_BOUND_S = 1e-6
"""Resolution of the reading that `listen` prints."""


class Usage(NamedTuple):
    """What a process holds."""

    resident_kb: int
    descriptors: int
    threads: int


def usage(pid: int) -> Usage:
    """What the system knows of a process."""
    status = Path(f"/proc/{pid}/status").read_text()
    resident_kb, threads = (
        int(re.search(rf"{key}:\s+(\d+)", status)[1])  # type: ignore[index]
        for key in ("VmRSS", "Threads")
    )
    return Usage(resident_kb, sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()), threads)


def children(pid: int) -> list[int]:
    """Processes that this one started."""
    return [int(text) for text in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def flight(duration_s: float, pace: str) -> list[str]:
    """Arguments of a flight on New Year's Eve, with a fast clock, and housekeeping.

    In real time a slow descent; otherwise a bench pattern of one beam, since what is computed and recorded of each beam
    takes most of the time.
    """
    keys = {
        "timing.rate_hz": str(RATE_HZ),
        "timing.epoch": "2031-12-31T23:50:00Z",
        "device.clock": f"{{offset_s: {OFFSET_S}, drift_ppm: {DRIFT_PPM}}}",
        "device.housekeeping_rate_hz": "10",
    }
    if pace == "max":
        keys["bench_pattern.duration_s"] = str(duration_s)
        keys["bench_pattern.beams"] = (
            "[{range_m: {start: 0, stop: 2000, period_s: 10}, closing_speed_mps: 50}]"
        )
    else:
        leg = f"speed_mps: {900 / duration_s}"
        keys["trajectory.waypoints"] = f"[{{altitude_m: 1500, {leg}}}, {{altitude_m: 600, {leg}}}]"
    scenario = "bench.yaml" if pace == "max" else "descent.yaml"
    return [scenario, *(word for pair in keys.items() for word in ("--set", "=".join(pair)))]


class Flown(NamedTuple):
    """What a flight left behind."""

    samples: list[dict[str, Usage]]
    """Usage of each process, each minute."""
    summary: dict[str, Any]
    listened: str
    """What `listen` counted."""
    last_s: float
    """Last time of validity that `listen` received."""
    took_s: float


def fly(duration_s: float, pace: str, folder: Path) -> Flown:
    """Fly, and sample all processes each minute."""
    received = (folder / "received.txt").open("w"), (folder / "listen.txt").open("w")
    output = ["--pace", pace, "--record", "run.mcap", "--summary", "run.json", "--plain"]
    run = subprocess.Popen(
        [*LIDAR_EMU, "run", *flight(duration_s, pace), "--port", "pty:lidar", "--baud", "921600", *output],
        cwd=folder,
        stdout=(folder / "run.txt").open("w"),
    )
    while not (folder / "lidar").exists():
        if run.poll() is not None:
            sys.exit("the run did not start")
        time.sleep(0.1)
    listen = subprocess.Popen(
        [*LIDAR_EMU, "listen", "--port", "lidar", "--baud", "921600", "--plain"],
        cwd=folder,
        stdout=received[0],
        stderr=received[1],
    )
    time.sleep(10)
    started, samples = time.monotonic(), []
    while run.poll() is None:
        samples.append(
            {
                "model": usage(run.pid),
                **{f"port {k}": usage(pid) for k, pid in enumerate(children(run.pid))},
                "listen": usage(listen.pid),
            }
        )
        print(len(samples) - 1, samples[-1], flush=True)
        try:
            run.wait(started + 60 * len(samples) - time.monotonic())
        except subprocess.TimeoutExpired:
            continue
    took_s = time.monotonic() - started
    listen.terminate()
    listen.wait(60)
    if run.returncode:
        sys.exit(f"the run ended with exit code {run.returncode}")
    lines = subprocess.run(
        ["tail", "-n", "20", "received.txt"], cwd=folder, stdout=subprocess.PIPE, text=True
    ).stdout
    return Flown(
        samples,
        json.loads((folder / "run.json").read_text()),
        (folder / "listen.txt").read_text().splitlines()[-1],
        float(re.findall(r"^ *([0-9.]+) s  unit", lines, re.MULTILINE)[-1]),
        took_s,
    )


def clock_error_s(duration_s: float, last_s: float) -> float:
    """Last reading, minus the closed form of a clock with offset and drift."""
    time_s = duration_s - 1 / RATE_HZ
    return last_s - (OFFSET_S + time_s + DRIFT_PPM * 1e-6 * time_s)


def found_faults(duration_s: float, flown: Flown) -> list[str]:
    """What grew, what was lost, and whether the clock is wrong."""
    samples, summary = flown.samples, flown.summary
    found, settled = [], samples[min(SETTLED_MINUTE, len(samples) // 2) :]
    for name in samples[0]:
        first, last = settled[0][name], settled[-1][name]
        if last.resident_kb - first.resident_kb > ALLOWED_KB:
            found.append(f"{name}: memory grew from {first.resident_kb} to {last.resident_kb} kB")
        if last[1:] != first[1:]:
            found.append(f"{name}: descriptors and threads {first[1:]} became {last[1:]}")
    sent = summary["shots"]["sent"] + summary["housekeeping"]["sent"]
    if f"messages {sent}," not in flown.listened:
        found.append(f"{sent} packets were sent; listen: {flown.listened}")
    if abs(clock_error_s(duration_s, flown.last_s)) > CLOCK_BOUND_S:
        found.append(f"the clock ended at {flown.last_s} s")
    return found


def page_text(arguments: str, duration_s: float, flown: Flown) -> str:
    """The part of the page between the markers."""
    samples, shots, lateness = flown.samples, flown.summary["shots"], flown.summary["lateness"]
    lines = [
        f"Measured {datetime.now(UTC):%Y-%m-%d} by `python tools/soak.py{arguments}` on {os.cpu_count()} cores, "
        f"Linux {platform.release()}, Python {platform.python_version()}, while the machine had other work.\n",
        "| minute | " + " | ".join(f"{name}: kB, descriptors, threads" for name in samples[0]) + " |",
        "|---" * (1 + len(samples[0])) + "|",
    ]
    shown = {0, 1, SETTLED_MINUTE, *range(10, len(samples), 10), len(samples) - 1}
    for minute in sorted(minute for minute in shown if minute < len(samples)):
        cells = (
            ", ".join(f"{number:,}".replace(",", " ") for number in each) for each in samples[minute].values()
        )
        lines.append(f"| {minute} | " + " | ".join(cells) + " |")
    timing = ""
    if lateness["count"]:
        figures = ((name, lateness[f"{name}_ns"] / 1e3) for name in ("p50", "p99", "max"))
        timing = "Due to written: " + ", ".join(f"{name} {us:.0f} us" for name, us in figures)
        timing += f"; {10 * flown.summary['steal_ticks']} ms were stolen by the host. "
    error_ms = 1e3 * clock_error_s(duration_s, flown.last_s)
    lines.append(
        f"\n{shots['sent']} of {shots['due']} shots ({duration_s / 3600:g} hours in {flown.took_s / 60:.1f} minutes), "
        f"{shots['late']} late, {sum(shots['dropped'].values())} dropped, and "
        f"{flown.summary['housekeeping']['sent']} housekeeping packets. {timing}`listen`: {flown.listened}. "
        f"The last reading of the clock was {flown.last_s:.3f} s, {error_ms:+.3f} ms from its closed form."
    )
    return "\n".join(lines)


def main() -> None:
    """Fly, judge, and update the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--pace", choices=["wall", "max"], default="wall")
    options = parser.parse_args()
    duration_s = 3600 * options.hours
    with tempfile.TemporaryDirectory() as folder:
        flown = fly(duration_s, options.pace, Path(folder))
    text = page_text("".join(f" {word}" for word in sys.argv[1:]), duration_s, flown)
    found = found_faults(duration_s, flown)
    print(text)
    if options.hours >= 1 and not found:
        before, begin, rest = PAGE.read_text().partition(f"<!-- {options.pace}: begin -->")
        PAGE.write_text(f"{before}{begin}\n{text}\n" + rest[rest.index(f"<!-- {options.pace}: end") :])
    sys.exit("\n".join(found) or 0)


if __name__ == "__main__":
    main()

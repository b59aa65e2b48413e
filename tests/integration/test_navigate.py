"""The navigation example beside `lidar-emu run` in another process."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from programs import FarEnd, Program
from slcan_lines import frames
from waiting import LIMIT_S

from lidar_protocol import CanCommandReader, CommandReader, default_interface

NAVIGATE = Path(__file__).resolve().parents[2] / "examples" / "navigation" / "navigate.py"
FOR_TEN_SECONDS = ["--set", "duration_s=10"]
HOPPING_CLOCK = """faults=[
    {kind: time_jump, jump_s: 100, from_s: 4, to_s: 5},
    {kind: time_jump, jump_s: -1, from_s: 6, to_s: 7}]"""
END = re.compile(
    r"error at the end, (\S+) s: (\S+) m east, (\S+) m north, (\S+) m of height, (\S+) mm/s; "
    r"(\d+) shots used, (\d+) not used"
)

LINE = re.compile(r" *(\S+) +\S+ +(\S+) .* (\d) of \d +(\d) of \d")
USED = default_interface().enumerations["trust"]["used"]
MORE_THAN_A_PTY_HOLDS = 200_000

Start = Callable[..., Program]


def assert_solutions(solutions: list[Any], lines: list[str]) -> None:
    """The lines that were printed are of solutions that were sent."""
    assert [each.sequence for each in solutions] == [number % 256 for number in range(len(solutions))]
    by_time = {f"{each.values['time_ns'] * 1e-9:.2f}": each.values for each in solutions}
    for line in lines:
        columns = LINE.match(line)
        assert columns is not None
        time_s, height_m, ranges, speeds = columns.groups()
        sent = by_time[time_s]
        assert abs(sent["altitude_m"] - float(height_m)) <= 0.006
        for what, used in (("range", ranges), ("speed", speeds)):
            assert [sent[f"{what}_trust_{beam}"] for beam in range(8)].count(USED) == int(used)


@pytest.mark.slow
def test_it_navigates_by_a_serial_port(start: Start, far_end: FarEnd, other_end: FarEnd) -> None:
    """A clock that hops ahead and back in between leaves shots that are not used, and nothing else."""
    flight = ["descent.yaml", *FOR_TEN_SECONDS]
    start("run", *flight, "--set", HOPPING_CLOCK, "--port", far_end.path, "--pace", "max").succeed()
    command = [sys.executable, str(NAVIGATE), *flight, "--port", other_end.path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as navigating:
        # The line is full until the program reads; what it holds when the port is opened is thrown away: zeros.
        stream = bytes(MORE_THAN_A_PTY_HOLDS) + bytes(far_end.data)
        threading.Thread(target=other_end.send, args=(stream,), daemon=True).start()
        output, complaint = navigating.communicate(timeout=LIMIT_S)
    assert (navigating.returncode, complaint) == (0, "")
    heading, columns, *lines, end = output.splitlines()
    assert " ".join(heading.split()) == "height, m error of velocity, mm/s tilt, deg beams used"
    assert " ".join(columns.split()) == "time true estimate east north up true est. range speed"
    assert len(lines) >= 4
    reported = END.fullmatch(end)
    assert reported is not None
    end_s, east_m, north_m, height_m, speed_mmps, used, unused = map(float, reported.groups())
    assert 9 < end_s <= 10
    assert abs(height_m) < 5
    assert speed_mmps < 300
    assert max(abs(east_m), abs(north_m)) < 40
    assert used + unused == 199, "all but the one that it starts from"
    assert 20 <= unused <= 40
    solutions = CommandReader(default_interface()).feed(bytes(other_end.data))
    assert len(solutions) == used
    assert_solutions(solutions, lines)


@pytest.mark.slow
def test_it_navigates_by_a_can_bus(start: Start, far_end: FarEnd, other_end: FarEnd) -> None:
    """Lines of slcan from the one adapter to the other."""
    far_end.deliver_to(other_end)
    process = subprocess.Popen(
        [sys.executable, str(NAVIGATE), "descent.yaml", "-i", "slcan", "-c", other_end.path],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        run = start(
            *("run", "descent.yaml", "-i", "slcan", "-c", far_end.path, "--bitrate", "1000000"),
            *("--pace", "max", *FOR_TEN_SECONDS),
        )
        run.succeed()
        output, _ = process.communicate(timeout=LIMIT_S)
    finally:
        process.kill()
        process.wait()
    reported = END.fullmatch(output.splitlines()[-1])
    assert process.returncode == 0
    assert reported is not None
    assert abs(float(reported[4])) < 5
    assert float(reported[5]) < 300
    reader, solutions = CanCommandReader(default_interface()), list[Any]()
    for frame in frames(other_end.data):
        solutions += reader.feed(frame.can_id, frame.data)
    assert len(solutions) == int(reported[6])
    assert reader.counters.foreign == reader.counters.incomplete == 0
    assert_solutions(solutions, output.splitlines()[2:-1])

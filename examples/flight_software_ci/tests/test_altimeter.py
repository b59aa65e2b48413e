"""The altimeter against an emulated lidar: truth decides, and faults are injected in flight."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from math import cos, radians
from pathlib import Path
from typing import Any

import pytest

PROGRAM = Path(__file__).parents[1] / "build" / "altimeter"
PACK = Path(__file__).with_name("pack")
SERIAL = ["--baud", "921600"]
TOLERANCE_M = 1.5
"""Five standard deviations of the lidar's range."""


class Altimeter:
    """The program, and its lines."""

    def __init__(self, port: str) -> None:
        self._process = subprocess.Popen([PROGRAM, port], stdout=subprocess.PIPE, text=True)

    def line(self) -> tuple[str, dict[str, float]]:
        """The next line: its first word, and its values by name."""
        assert self._process.stdout is not None
        word, *values = self._process.stdout.readline().split()
        return word, {name: float(text) for name, text in (value.split("=") for value in values)}

    def heights(self, count: int) -> dict[int, float]:
        """The next heights by shot."""
        found: dict[int, float] = {}
        while len(found) < count:
            word, values = self.line()
            if word == "height":
                found[int(values["shot"])] = values["height_m"]
        return found

    def skip_to(self, word: str) -> dict[str, float]:
        """The values of the next line that begins with this word."""
        while (line := self.line())[0] != word:
            continue
        return line[1]

    def end(self) -> None:
        """Kill the program, if it still runs."""
        with self._process:
            self._process.kill()


@pytest.fixture
def altimeter() -> Iterator[Callable[[str], Altimeter]]:
    """Start the altimeter on a port."""
    started: list[Altimeter] = []

    def start(port: str) -> Altimeter:
        started.append(Altimeter(port))
        return started[-1]

    yield start
    for each in started:
        each.end()


def true_heights_m(shot: Any) -> list[float]:
    """What each beam that the lidar calls valid sees in truth, in ascending order."""
    beams = zip(
        shot.truth["true_range_m"],
        shot.measurement["beam_angle_deg"],
        shot.measurement["range_valid"],
        strict=True,
    )
    return sorted(range_m * cos(radians(angle_deg)) for range_m, angle_deg, valid in beams if valid)


def assert_between_beams(heights: dict[int, float], lidar: Any) -> None:
    """The height is one that the beams see: the ground is not flat."""
    shots = {shot.number: shot for shot in lidar.wait_for_shots(max(heights) + 1)}
    for number, height_m in heights.items():
        lowest_m, *_, highest_m = true_heights_m(shots[number])
        assert lowest_m - TOLERANCE_M <= height_m <= highest_m + TOLERANCE_M


def test_every_shot_with_three_beams_is_a_height(lidar_emulator, altimeter) -> None:
    lidar = lidar_emulator("descent.yaml", arguments=[*SERIAL, "--duration", "5"])
    heights = altimeter(lidar.port).heights(80)
    shots = [shot for shot in lidar.wait_for_shots(100) if len(true_heights_m(shot)) >= 3]
    assert list(heights) == [shot.number for shot in shots][:80]
    assert_between_beams(heights, lidar)


def test_a_wrong_beam_is_outvoted(lidar_emulator, altimeter) -> None:
    lidar = lidar_emulator("descent.yaml", arguments=SERIAL)
    program = altimeter(lidar.port)
    program.heights(10)
    lidar.inject("bias", beams=[2], range_m=1000)
    program.heights(20)  # in flight already
    assert_between_beams(program.heights(40), lidar)


def test_damaged_packets_are_dropped(lidar_emulator, altimeter) -> None:
    faults = [{"kind": "bit_errors", "rate": 1e-4}]
    lidar = lidar_emulator(
        "descent.yaml", settings={"faults": faults}, arguments=[*SERIAL, "--duration", "5"]
    )
    program = altimeter(lidar.port)
    assert_between_beams(program.heights(60), lidar)
    assert program.skip_to("end")["bad_frames"] > 0
    assert lidar.finish()["shots"]["sent"] == 100


def test_a_silent_line_is_reported_and_heights_resume(lidar_emulator, altimeter) -> None:
    lidar = lidar_emulator("descent.yaml", arguments=SERIAL)
    program = altimeter(lidar.port)
    program.heights(10)
    lidar.inject("disconnect", lasts_s=1)
    program.skip_to("stale")
    program.heights(10)


def test_heights_are_graded_on_a_low_approach(lidar_trial) -> None:
    found = lidar_trial(f"{PACK}/low_approach", f"{PROGRAM} {{port}}", *SERIAL)
    assert found.passes, found

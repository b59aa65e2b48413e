"""A slow level says how long it will take; the clock is an argument."""

from __future__ import annotations

import logging
from itertools import count

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_in_blocks, measure_whole

SHOTS = {"level": "reference", "duration_s": "0.25", "instrument.detection.peak": "hann"}


def notes(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if "about" in record.getMessage()]


def test_a_run_tells_after_the_second_shot_and_every_ten_seconds(caplog: pytest.LogCaptureFixture) -> None:
    """Five shots of six seconds each, after a first one that compiles for a minute."""
    ticks = count(60 * 10**9, 6 * 10**9)
    measure_whole(build_model(load("descent", SHOTS)), lambda: next(ticks))
    assert notes(caplog) == [
        "lidar-emu: level reference: 2 of 5 shots, about 18 s left",
        "lidar-emu: level reference: 4 of 5 shots, about 6 s left",
    ]


def test_blocks_are_those_without_a_clock() -> None:
    model = build_model(load("descent", SHOTS))
    told, silent = list(measure_in_blocks(model, 2, lambda: 0)), list(measure_in_blocks(model, 2))
    assert [len(block.shot) for block in told] == [2, 2, 1]
    for one, other in zip(told, silent, strict=True):
        np.testing.assert_array_equal(one.range_m, other.range_m)
        np.testing.assert_array_equal(one.reason, other.reason)


def test_simulate_tells_and_fast_levels_do_not(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    simulate("descent", SHOTS | {"level": "spectral"})
    assert not notes(caplog)
    simulate("descent", SHOTS)
    assert notes(caplog)[0].startswith("lidar-emu: level reference: 2 of 5 shots, about ")


def test_a_callers_own_progress_replaces_the_log(caplog: pytest.LogCaptureFixture) -> None:
    told: list[tuple[int, int]] = []
    simulate("descent", SHOTS, progress=lambda *done: told.append(done))
    assert told == [(shot, 5) for shot in range(1, 6)]
    assert not notes(caplog)

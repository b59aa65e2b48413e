"""Computing times of shots: alone and in blocks, by beamlets and beams; of rays, by cells of the ground."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.casting_scene import FOUR_BEAMS, Rays, rolling_ground, shots
from lidar_emu.scenario.load import load
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.shots.model import build_model, initial_state, measure
from lidar_emu.wire import Encoder

BEAMLETS = (1, 7, 19, 61, 127)
BEAMS = (1, 4, 16, 64)
GRID_SIDES = (100, 300, 1000, 2000)
_BLOCK, _ROUNDS, _ALONE = 128, 200, 60
_TILT_DEG = 22.5


class ShotCost(NamedTuple):
    """Least times, in seconds: other load on the machine only adds to them."""

    alone_s: float
    """One shot, computed alone."""
    packet_s: float
    """Its packet."""
    beam_s: float
    """A beam of a shot that is computed in a block."""


def least_times_s(jobs: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Least time of each call, called in turn, so that a busy while of the machine does not fall on one of them."""
    times = [_seconds_each(jobs) for _ in range(rounds + 1)]
    return [min(of_job) for of_job in zip(*times[1:], strict=True)]


def _seconds_each(jobs: Sequence[Callable[[], object]]) -> list[float]:
    seconds = []
    for job in jobs:
        begun = time.perf_counter()
        job()
        seconds.append(time.perf_counter() - begun)
    return seconds


def shot_costs(cases: Sequence[tuple[int, int]]) -> list[ShotCost]:
    """Cost of shots for each number of beamlets and beams."""
    jobs = [job for beamlets, beams in cases for job in _shot_jobs(beamlets, beams)]
    times = iter(least_times_s(jobs, _ROUNDS))
    return [
        ShotCost(next(times) / _ALONE, next(times) / _ALONE, next(times) / (_BLOCK * beams))
        for _, beams in cases
    ]


def _shot_jobs(beamlets: int, beams: int) -> Iterator[Callable[[], object]]:
    """Calls whose times become a `ShotCost`: shots of `descent.yaml` at level spectral, halfway down."""
    azimuths_deg = 360.0 * np.arange(beams) / beams
    keys = {
        "level": "spectral",
        "timing.rate_hz": 100,
        "instrument.optics.beamlets": beamlets,
        "scanner": {
            "pattern": {"kind": "directions", "beams": [[_TILT_DEG, float(a)] for a in azimuths_deg]}
        },
    }
    model = build_model(load("descent.yaml", keys))
    state = initial_state(model)
    first = model.shot_count // 2
    encoder = Encoder(model.scenario.wire, False, False, beams)
    measured = measure(model, first, 1, state)[0]
    yield lambda: [measure(model, first + shot, 1, state) for shot in range(_ALONE)]
    yield lambda: [list(encoder.packets(measured)) for _ in range(_ALONE)]
    yield lambda: measure(model, first, _BLOCK, state)


def ground_costs() -> Iterator[tuple[int, float, float]]:
    """For each size of a grid: cells, time to make it ready, and time for four beams of 61 beamlets, in seconds."""
    rays = shots(FOUR_BEAMS, 32)
    grounds = [rolling_ground(side, "bilinear") for side in GRID_SIDES]
    ready_s = least_times_s([partial(rolling_ground, side, "bilinear") for side in GRID_SIDES], 5)
    cast_s = least_times_s([partial(_cast_all, ground, rays) for ground in grounds], _ROUNDS)
    for side, of_ready_s, of_cast_s in zip(GRID_SIDES, ready_s, cast_s, strict=True):
        yield side**2, of_ready_s, of_cast_s / len(rays)


def _cast_all(ground: GridGround, rays: list[Rays]) -> None:
    for each in rays:
        ground.cast(each.origin_m, each.direction, bundle=each.bundle)

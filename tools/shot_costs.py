"""Computing times of shots: alone and in blocks, by beamlets and beams; of rays, by cells of the ground."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from lidar_emu.bench.casting_scene import FOUR_BEAMS, Rays, rolling_ground, shots
from lidar_emu.scenario.load import load
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.shots.model import build_model, initial_state, measure
from lidar_emu.wire import Encoder

BEAMLETS = (1, 7, 19, 61, 127)
BEAMS = (1, 4, 16, 64)
GRID_SIDES = (100, 300, 1000, 2000)
_BLOCK, _ROUNDS, _ALONE = 128, 15, 60
_TILT_DEG = 22.5


class ShotCost(NamedTuple):
    """Least times, in seconds: other load on the machine only adds to them."""

    alone_s: float
    """One shot, computed alone."""
    packet_s: float
    """Its packet."""
    beam_s: float
    """A beam of a shot that is computed in a block."""


def least_time_s(job: Callable[[], object], rounds: int = _ROUNDS) -> float:
    """Least time of a call; the first is not counted."""
    job()
    times = []
    for _ in range(rounds):
        begun = time.perf_counter()
        job()
        times.append(time.perf_counter() - begun)
    return min(times)


def shot_cost(beamlets: int, beams: int = 4) -> ShotCost:
    """Cost of shots of `descent.yaml` at level spectral, in the middle of the descent, from truth to packet."""
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

    def alone() -> None:
        for shot in range(_ALONE):
            measure(model, first + shot, 1, state)

    return ShotCost(
        least_time_s(alone) / _ALONE,
        least_time_s(lambda: [list(encoder.packets(measured)) for _ in range(_ALONE)]) / _ALONE,
        least_time_s(lambda: measure(model, first, _BLOCK, state)) / (_BLOCK * beams),
    )


def ground_costs() -> Iterator[tuple[int, float, float]]:
    """For each size of a grid: cells, time to make it ready, and time for four beams of 61 beamlets, in seconds."""
    for side in GRID_SIDES:
        ground = rolling_ground(side, "bilinear")
        ready_s = least_time_s(partial(rolling_ground, side, "bilinear"), 3)
        rays = shots(FOUR_BEAMS, 32)
        yield side**2, ready_s, least_time_s(partial(_cast_all, ground, rays)) / len(rays)


def _cast_all(ground: GridGround, rays: list[Rays]) -> None:
    for each in rays:
        ground.cast(each.origin_m, each.direction, bundle=each.bundle)

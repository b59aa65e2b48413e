"""Times of several jobs, interleaved so that other load on the machine affects all alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lidar_emu.runtime.clock import Clock


def median_times_s(jobs: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Median of `rounds` times of each job, all jobs once in each round; each is called once beforehand."""
    clock = Clock()
    for job in jobs:
        job()
    times = np.empty((rounds, len(jobs)))
    for row in times:
        for i, job in enumerate(jobs):
            start_ns = clock.now_ns()
            job()
            row[i] = (clock.now_ns() - start_ns) * 1e-9
    return [float(time) for time in np.median(times, axis=0)]

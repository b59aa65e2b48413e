"""Computing time of a run, from the time of a block of its shots."""

from __future__ import annotations

from collections.abc import Callable

from lidar_emu.shots.model import BLOCK_SHOTS, Model, ModelState, initial_state, measure, state_before

_LONGEST_BLOCK_NS = 2 * 10**9


def estimate_run_s(model: Model, now_ns: Callable[[], int]) -> float:
    """Estimate the computing time of all shots on one core, without start and compilation.

    Args:
        model: a run with at least one shot.
        now_ns: reads a clock, in nanoseconds.
    """
    first = model.shot_count // 2
    state = ModelState(state_before(model, first), initial_state(model).faults)

    def time_ns(count: int) -> int:
        begun_ns = now_ns()
        measure(model, first, count, state)
        return now_ns() - begun_ns

    time_ns(1)  # compiles
    one_ns = time_ns(1)
    count = min(BLOCK_SHOTS, model.shot_count - first)
    if one_ns * count > _LONGEST_BLOCK_NS:
        return one_ns * 1e-9 * model.shot_count
    return time_ns(count) * 1e-9 * model.shot_count / count

"""Errors over their stated sigma on planes of many incidences, and by range on the flights that are shipped.

The figure is the 68.27 % quantile of |error|/sigma of correct locks, which is 1 where sigma is right, without the
systematic part that the plan expects.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product
from math import cos, radians

import numpy as np

import lidar_emu
from benchmarks.flight_sigma import correct_locks, fly
from benchmarks.scenes import scanner, trajectory
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import Optics
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import Scenario

INCIDENCES_DEG, RANGES_M = (0.0, 10.0, 22.5, 45.0, 62.0), (15.0, 50.0, 200.0, 800.0, 1700.0)
SNRS_DB, LINES_HZ, SPEEDS_MPS = (25.0, 35.0, 45.0), (0.0, 3000.0), (0.5, 5.0, 30.0)
RATE_HZ, SHOTS_PER_RUN = 50.0, 20
BAND = (0.85, 1.25)

FLIGHTS = (
    *product(("descent", "powered_descent", "paper_fig5", "hazards", "dusty_landing"), (False, True)),
    ("obstacles", False),
    ("terrain_step_2023", False),
)
"""Names, and whether with `ndl_fine` in place of their own instrument."""
ENDS_M = (0.0, 15.0, 30.0, 60.0, 130.0, np.inf)
_FEWEST = 60
"""Errors of which a quantile is stated, at least."""


def quantile(ratios: FloatArray) -> float:
    """68.27 % quantile of the absolute values."""
    return float(np.quantile(np.abs(ratios), 0.6827))


def plane_ratios(
    incidence_deg: float,
    range_m: float,
    speed_mps: float,
    snr_db: float,
    settings: dict[str, str],
    shots: int,
) -> FloatArray:
    """Errors over sigma (2, n) of range and speed of a lidar that sinks over level ground.

    Args:
        incidence_deg: angle of all beams off nadir.
        range_m, speed_mps, snr_db: range in the middle of each run, rate of sink, mean signal-to-noise ratio.
        settings: other keys.
        shots: least number of errors.
    """
    flown_s = SHOTS_PER_RUN / RATE_HZ
    keys = {
        "timing.rate_hz": str(RATE_HZ),
        "duration_s": str(flown_s),
        "site": "flat",
        "scanner": scanner(incidence_deg, *((0, 90, 180, 270) if incidence_deg else ())),
        "trajectory": trajectory(
            range_m * cos(radians(incidence_deg)), 0.51 * speed_mps * flown_s, speed_mps
        ),
        **settings,
    }
    pilot = lidar_emu.simulate(load("descent", keys), seed=0)
    mean_snr = np.nanmean(10.0 ** (0.1 * pilot.snr_db))
    watts = 10.0 ** (0.1 * snr_db) / mean_snr * Optics().laser_power_w
    scenario = load("descent", keys | {"instrument.optics.laser_power_w": str(float(watts))})
    found: list[tuple[FloatArray, FloatArray]] = []
    seed = 0
    while sum(ratios.shape[1] for _, ratios in found) < shots:
        seed += 1
        found.append(errors_over_sigma(scenario.model_copy(update={"seed": seed})))
    return np.concatenate([ratios for _, ratios in found], axis=1)


def errors_over_sigma(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Ranges (n,) of the correct locks of a flight, and their errors over sigma (2, n)."""
    run, error, bias, sigma = fly(scenario)
    right = correct_locks(run, error - bias)
    return run.range_m[right], ((error - bias) / sigma)[:, right]


def parts(shots: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table on planes."""
    yield (
        *("speed, incidence", "range: median [least, most]", "cells in 0.85 to 1.25"),
        *("within 3 sigma: mean, least", "speed: median [least, most]"),
    )
    for speed_mps, incidence_deg in product(SPEEDS_MPS, INCIDENCES_DEG):
        cells = []
        for range_m, snr_db, line_hz in product(RANGES_M, SNRS_DB, LINES_HZ):
            settings = {
                "instrument": f"{{base: ndl_fine, waveform: {{linewidth_hz: {line_hz}}}}}",
            }
            ratios = plane_ratios(incidence_deg, range_m, speed_mps, snr_db, settings, shots)
            within = float(np.mean(np.abs(ratios[0]) < 3.0))
            cells.append((quantile(ratios[0]), quantile(ratios[1]), within))
        by_range, by_speed, within = np.array(cells).T
        in_band = np.mean((by_range > BAND[0]) & (by_range < BAND[1]))
        yield (
            f"{speed_mps:g} m/s, {incidence_deg:g}\N{DEGREE SIGN}",
            f"{np.median(by_range):.2f} [{by_range.min():.2f}, {by_range.max():.2f}]",
            f"{100 * in_band:.0f} %",
            f"{within.mean():.3f}, {within.min():.3f}",
            f"{np.median(by_speed):.2f} [{by_speed.min():.2f}, {by_speed.max():.2f}]",
        )


def flight_parts(seeds: int = 4) -> Iterator[tuple[str, ...]]:
    """Rows of the table on flights."""
    yield (
        "flight",
        "",
        *(
            f"{first:g} to {last:g} m" if last < np.inf else f"beyond {first:g} m"
            for first, last in pairwise(ENDS_M)
        ),
    )
    for name, fine in FLIGHTS:
        settings = {"instrument": "ndl_fine"} if fine else {}
        flown = [errors_over_sigma(load(name, settings | {"seed": str(k)})) for k in range(1, seeds + 1)]
        ranges_m = np.concatenate([each for each, _ in flown])
        ratios = np.concatenate([each for _, each in flown], axis=1)
        bins = np.digitize(ranges_m, ENDS_M) - 1
        for quantity, each in zip(("range", "speed"), ratios, strict=True):
            cells = [each[bins == k] for k in range(len(ENDS_M) - 1)]
            figures = (f"{quantile(cell):.2f}" if len(cell) >= _FEWEST else "" for cell in cells)
            yield f"{name}.yaml{', `ndl_fine`' if fine else ''}", quantity, *figures

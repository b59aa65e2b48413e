"""Share of the 90 % intervals of an instrument's keys that hold the truth, by `lidar-emu fit --instrument`.

    python -m benchmarks.key_coverage --logs 400             # 4 min
    python -m benchmarks.key_coverage --logs 200 --no-truth

The keys of the logs are drawn between the same bounds, by another seed; all are fitted by the same flights.
"""

from __future__ import annotations

import click
import numpy as np
from scipy.stats import binomtest

from lidar_emu.scenario.load import load, require_flight
from lidar_emu.sensor_fit.instrument_keys import (
    FLIGHTS,
    PEAKS,
    Problem,
    estimates_of,
    fly_design,
    free_keys,
    posterior_of,
)

EDGES_M = np.array([0.0, 200.0, 500.0, 1000.0, 2200.0])


def known_problem(scenario: str, has_truth: bool) -> Problem:
    """A sensor without steps and limits on a shipped flight, at 10 Hz."""
    flown = require_flight(load(scenario, {"timing.rate_hz": 10}))
    keys, nothing = free_keys(flown.instrument), (np.nan, np.nan)
    return Problem(flown, keys, PEAKS[1:], EDGES_M, nothing, (-np.inf, np.inf), has_truth, 2.0)


@click.command(help=__doc__)
@click.option("--logs", default=400, show_default=True)
@click.option("--flights", default=FLIGHTS, show_default=True)
@click.option("--scenario", default="descent", show_default=True)
@click.option("--truth/--no-truth", default=True, show_default=True)
def main(logs: int, flights: int, scenario: str, truth: bool) -> None:
    problem = known_problem(scenario, truth)
    ignored: list[int] = []
    flown = fly_design(problem, flights, 1, ignored.append)
    sensors = fly_design(problem, 1 << (logs - 1).bit_length(), 2, ignored.append)
    hits, tells, peak_right = np.zeros(len(problem.keys)), np.zeros(len(problem.keys)), 0.0
    for parts, peak, figures in zip(*(column[:logs] for column in sensors), strict=True):
        posterior = posterior_of(flown, figures)
        for place, found in enumerate(estimates_of(problem, posterior)):
            true = float(problem.keys[place].value(parts[place]))
            hits[place] += found.estimate.low <= true <= found.estimate.high
            tells[place] += found.tells
        peak_right += posterior.weight[posterior.peak == peak].sum()
    for key, hit, told in zip(problem.keys, hits, tells, strict=True):
        low, high = binomtest(int(hit), logs).proportion_ci(0.95)
        print(
            f"{key.key:45} {100 * hit / logs:5.1f} % ({100 * low:.1f} to {100 * high:.1f}); "
            f"tells in {100 * told / logs:.0f} %"
        )
    print(f"probability of the right peak method {peak_right / logs:.2f}, of {len(problem.peaks)}")


if __name__ == "__main__":
    main()

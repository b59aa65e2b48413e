"""Share of the 90 % intervals of `lidar-emu fit` that hold the truth, over synthetic logs of drawn sensors.

    python -m benchmarks.fit_coverage --logs 200

Each log is 120 s of one beam at 10 Hz, fitted with its truth and without it. Prints a row per figure.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
from scipy.stats import binomtest, t

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from synthetic_logs import KnownSensor, drawn_sensor, synthetic_log

from lidar_emu.sensor_fit.flight_log import FlightLog
from lidar_emu.sensor_fit.noise_law import Interval
from lidar_emu.sensor_fit.validation import characterised


def known_values(sensor: KnownSensor) -> dict[str, float]:
    """The true value of each figure."""
    known = {
        "range bias": sensor.range_bias_m, "range scale error": sensor.range_scale_error,
        "range latency": sensor.latency_s, "speed latency": sensor.latency_s, "speed bias": sensor.speed_bias_mps,
        "speed scale error": sensor.speed_scale_error, "range dropouts": sensor.dropout_probability,
        "range false locks": sensor.false_probability * (1 - sensor.dropout_probability),
    }  # fmt: skip
    for what, scale, degrees in (
        ("range", sensor.range_scale_m, sensor.range_degrees),
        ("speed", sensor.speed_scale_mps, sensor.speed_degrees),
    ):
        known[f"{what} noise, robust sigma"] = scale * float(t.ppf(0.75, degrees)) / 0.6745
        known[f"{what} noise, 95 % half-width"] = scale * float(t.ppf(0.975, degrees))
        known[f"{what} noise, degrees of freedom"] = degrees
    return known


def intervals(seed: int, with_truth: bool) -> Iterator[tuple[str, Interval, float]]:
    """Each interval of a log, and the value that it should hold."""
    sensor = drawn_sensor(seed)
    columns = synthetic_log(sensor, seed)
    if not with_truth:
        columns |= {name: np.full_like(columns[name], np.nan) for name in columns if name.startswith("true_")}
    known = known_values(sensor)
    for row in characterised(FlightLog("synthetic", **columns), 2.0).rows:
        if row.what in known and np.isfinite(row.estimate.low):
            yield row.what, row.estimate, known[row.what]


def coverage(logs: int, with_truth: bool) -> dict[str, tuple[int, int]]:
    """How many intervals hold the truth, of how many, by figure."""
    counts: dict[str, tuple[int, int]] = {}
    for seed in range(logs):
        for what, found, true in intervals(seed, with_truth):
            hits, of = counts.get(what, (0, 0))
            counts[what] = hits + int(found.low <= true <= found.high), of + 1
    return counts


@click.command(help=__doc__)
@click.option("--logs", default=200, show_default=True)
def main(logs: int) -> None:
    for with_truth in (True, False):
        print("with truth" if with_truth else "without truth")
        for what, (hits, of) in coverage(logs, with_truth).items():
            low, high = binomtest(hits, of).proportion_ci(0.95)
            print(
                f"  {what:36} {hits:5} of {of:5}  {100 * hits / of:5.1f} %  ({100 * low:.1f} to {100 * high:.1f})"
            )


if __name__ == "__main__":
    main()

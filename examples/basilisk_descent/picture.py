"""Plot a landing: Basilisk's truth and the navigator's estimate."""

import argparse
import csv
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

mpl.use("Agg")
from matplotlib import pyplot as plt

Column = NDArray[np.float64]


def columns(file: Path) -> dict[str, Column]:
    """The columns of a CSV file of numbers, by name; NaN for a cell that is missing."""
    with file.open(newline="") as opened:
        names, *rows = csv.reader(opened)
    values = np.array([[float(cell) for cell in row] + [np.nan] * (len(names) - len(row)) for row in rows])
    return dict(zip(names, values.T, strict=True))


def draw(truth: dict[str, Column], estimate: dict[str, Column], file: Path) -> None:
    """Plot height, descent rate and drift against time."""
    drift_mps = np.hypot(truth["east_mps"], truth["north_mps"])
    panels = [
        ("height above ground, m", truth["height_m"], estimate["height_m"]),
        ("descent rate, m/s", -truth["up_mps"], -estimate["climb_mps"]),
        ("drift, m/s", drift_mps, estimate["drift_mps"]),
    ]
    figure, axes = plt.subplots(1, 3, figsize=(9, 2.8), layout="constrained")
    for axis, (label, flown, estimated) in zip(axes, panels, strict=True):
        axis.plot(estimate["time_s"], estimated, color="tab:orange", lw=3, alpha=0.6, label="navigator")
        axis.plot(truth["time_s"], flown, color="black", lw=0.9, label="Basilisk")
        axis.set(xlabel="time, s", ylabel=label, ylim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].legend(frameon=False)
    figure.savefig(file, dpi=90)


def main() -> None:
    """Plot the files named on the command line."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("truth", type=Path, help="CSV file of simulation.py --log")
    options.add_argument("estimate", type=Path, help="CSV file of navigator.py --log")
    options.add_argument("picture", type=Path, help="PNG, or another format of matplotlib")
    arguments = options.parse_args()
    draw(columns(arguments.truth), columns(arguments.estimate), arguments.picture)


if __name__ == "__main__":
    main()

"""Algorithm development in batch: other rules, or another model of the ground, over scenarios and seeds."""

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from beams import Array
from error_state import MARE, POSITION, VELOCITY, Ground
from trials import Log, fly, start
from trust import CAREFUL, NAMED, Rules
from truth import Truth

import lidar_emu
from lidar_emu.errors import InputError
from lidar_emu.report.plot_style import check_plot_path, styled, titled_figure, write_plot

SETTLED_S = 5.0
"""Time from which errors count."""

MEANINGS = {
    "careful": "careful: rejects outliers, scales σ to the noise, resets if lost",
    "stubborn": "stubborn: rejects outliers, trusts the stated σ, never resets",
    "credulous": "credulous: takes all that is flagged valid",
    "blind": "blind: inertial unit alone",
}
SCENES = {
    "powered_descent": "powered_descent\nengines, to the touchdown",
    "homodyne_sign": "homodyne_sign\n2 of 4 beams wrong for 2 s",
    "terrain_step_2023": "terrain_step_2023\nground falls by 3 km",
    "noisy_descent_2025": "noisy_descent_2025\nnoise of 80 m and 2 m/s",
}
"""What happens in a scenario."""


class Variant(NamedTuple):
    """Variant of the navigator."""

    rules: Rules
    ground: Ground


class Study(NamedTuple):
    """Variants, and the scenarios on which they are compared."""

    variants: Mapping[str, Variant]
    scenarios: Sequence[str]


STUDIES = {
    "rules": Study(
        {name: Variant(rules, MARE) for name, rules in NAMED.items()},
        ("powered_descent", "homodyne_sign", "terrain_step_2023", "noisy_descent_2025"),
    ),
    "ground": Study(
        {f"relief {sigma}": Variant(CAREFUL, Ground(relief_sigma=sigma)) for sigma in (5e-4, 2e-3, 8e-3)},
        ("descent", "powered_descent"),
    ),
}


def fly_all(scenario_name: str, variants: Mapping[str, Variant], seed: int) -> dict[str, Log]:
    """Fly the same measurements through each variant."""
    scenario = lidar_emu.load(f"{scenario_name}.yaml")
    truth, run = Truth(scenario), lidar_emu.simulate(scenario, seed=seed)
    first_ns = int(run.time_ns[0, 0])
    return {
        name: fly(truth, run, start(truth, first_ns, seed, *variant)) for name, variant in variants.items()
    }


def speed_errors(log: Log) -> Array:
    """Magnitudes (shots,) of the velocity error."""
    lengths: Array = np.linalg.norm(log.errors[:, VELOCITY], axis=1)
    return lengths


def height_errors(log: Log) -> Array:
    """Magnitudes (shots,) of the height error."""
    return np.abs(log.errors[:, POSITION][:, 2])


def summary(logs: Sequence[Log]) -> str:
    """A row of the table: errors that 95 % of the shots of all seeds do not exceed, errors at the end, and normalised
    innovations squared."""
    settled = [log.time_s >= SETTLED_S for log in logs]
    figures = []
    for errors_of in (height_errors, speed_errors):
        all_errors = [errors_of(log) for log in logs]
        settled_errors = np.concatenate([each[late] for each, late in zip(all_errors, settled, strict=True)])
        figures += [np.quantile(settled_errors, 0.95), rms(np.array([each[-1] for each in all_errors]))]
    drift_m = rms(np.array([np.linalg.norm(log.errors[-1, :2] - log.errors[0, :2]) for log in logs]))
    nis, accepted = (
        np.sum([values[late].sum() for values, late in zip(column, settled, strict=True)])
        for column in ([log.nis for log in logs], [log.accepted for log in logs])
    )
    nis_text = f"{nis / accepted:9.3g}" if accepted else "        -"
    return "".join(f"{figure:10.3g}" for figure in (*figures, drift_m)) + nis_text


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


@styled
def draw(results: Mapping[str, Mapping[str, Sequence[Log]]], file: Path) -> None:
    """Plot the rms errors of height and velocity over the seeds against time; light on dark in FILE-dark.png."""
    from matplotlib.ticker import LogLocator

    panels = {"height error (m)": height_errors, "velocity error (m/s)": speed_errors}
    flights = len(next(iter(next(iter(results.values())).values())))
    title = f"Errors of the navigation: root mean square of {flights} flights"
    figure = titled_figure(title, (10, 6.2), 14, dpi=110)
    axes = figure.subplots(2, len(results), sharex="col", sharey="row", squeeze=False)
    for axis, label in zip(axes[:, 0], panels, strict=True):
        axis.set_ylabel(label)
    for column, (scenario, by_variant) in zip(axes.T, results.items(), strict=True):
        column[0].set_title(SCENES.get(scenario, scenario), fontsize=10)
        column[1].set_xlabel("time (s)")
        for axis, errors_of in zip(column, panels.values(), strict=True):
            for k, (name, logs) in enumerate(by_variant.items()):
                squares = np.mean([errors_of(log) ** 2 for log in logs], axis=0)
                axis.plot(
                    logs[0].time_s, np.sqrt(squares), label=MEANINGS.get(name, name), zorder=3 - 0.1 * k
                )
            axis.set_yscale("log")
            axis.yaxis.set(major_locator=LogLocator(100), major_formatter="{x:g}")
            axis.minorticks_off()
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    write_plot(figure, file)


def main() -> None:
    """Fly, print, plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", type=int, default=8, metavar="N")
    parser.add_argument(
        "--plot", type=Path, metavar="FILE", help="PNG, SVG or PDF; FILE-dark.png: light on dark"
    )
    arguments = parser.parse_args()
    if arguments.seeds < 1:
        parser.error(f"--seeds {arguments.seeds}: must be at least 1")
    if arguments.plot:
        try:
            check_plot_path(arguments.plot)
        except InputError as error:
            parser.error(str(error))
    study, seeds = STUDIES[arguments.study], range(1, arguments.seeds + 1)
    results: dict[str, dict[str, list[Log]]] = {}
    print(f"{'':34}{'height, m':>20}{'velocity, m/s':>20}{'drift, m':>10}")
    print(f"{'':34}{'95 %':>10}{'end':>10}{'95 %':>10}{'end':>10}{'end':>10}{'NIS':>9}")
    with ProcessPoolExecutor() as pool:
        for scenario in study.scenarios:
            count = len(seeds)
            by_seed = list(pool.map(fly_all, [scenario] * count, [study.variants] * count, seeds))
            results[scenario] = {name: [logs[name] for logs in by_seed] for name in study.variants}
            for name, logs in results[scenario].items():
                print(f"{scenario:20}{name:14}{summary(logs)}", flush=True)
    if arguments.plot:
        draw(results, arguments.plot)


if __name__ == "__main__":
    main()

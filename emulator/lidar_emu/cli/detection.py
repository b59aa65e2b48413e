"""`lidar-emu detection`: predicted detection and false-detection probabilities of an instrument over a site."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidar_emu.cli.options import (
    check_plot,
    load_scenario,
    number_in,
    plot_option,
    scenario_argument,
    settings_option,
)
from lidar_emu.cli.terminal import print_line
from lidar_emu.errors import InputError

if TYPE_CHECKING:
    from lidar_emu.plan.detection_forecast import DetectionForecast
    from lidar_emu.scenario.schema import FlightScenario

_TABLE_ALTITUDES, _PLOT_ALTITUDES = 16, 200
_LOWEST_M, _HIGHEST_M = 1e-3, 1e9
_COLUMNS = (
    "segment_steady",
    "segment_speckle",
    "measurement_steady",
    "measurement_independent",
    "measurement_shared",
    "false_lock_steady",
    "false_lock_speckle",
)


@click.command(short_help="Detection and false-alarm probabilities by altitude, before a flight.")
@scenario_argument
@settings_option
@click.option(
    "--altitudes", metavar="LOW:HIGH", default="10:12000", show_default=True, help="Metres above the ground."
)
@plot_option("carrier-to-noise ratio and probabilities")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def detection(
    scenario: str, settings: tuple[str, ...], altitudes: str, plot: tuple[str, ...], as_json: bool
) -> None:
    """Predict what SCENARIO's instrument detects over a level plane of its site's surface.

    Per altitude and beam angle of all patterns: slant range, mean carrier-to-noise ratio of the highest bin, and the
    probabilities of detecting one segment, of detecting the measurement (as many segments as the instrument's rule
    requires), and that a noise bin is the strongest. Each for steady echoes and in speckle: independent fading of each
    segment ("own", fast flight) and a fade "shared" by all three (hover) are its bounds.

    \b
    lidar-emu detection descent.yaml
    lidar-emu detection descent.yaml --altitudes 100:5000 --plot detection.png
    lidar-emu detection descent.yaml --set site=mars --set instrument.optics.laser_power_w=0.1
    lidar-emu detection my.yaml --json
    """
    low_m, high_m = _altitudes(altitudes)
    check_plot(plot)
    import numpy as np

    from lidar_emu.plan.detection_forecast import forecast_detection
    from lidar_emu.scenario.load import require_flight

    flown = require_flight(load_scenario(scenario, None, None, settings))

    def forecast(count: int) -> DetectionForecast:
        return forecast_detection(flown, np.geomspace(low_m, high_m, count))

    if plot:
        from lidar_emu.report.statistics_plots import plot_detection

        plotted = forecast(_PLOT_ALTITUDES)
        for path in plot:
            plot_detection(plotted, flown.name, Path(path))
            click.echo(f"{path}: {flown.name}", err=as_json)
    if as_json:
        print_line(json.dumps(_document(flown, forecast(_TABLE_ALTITUDES)), indent=2))
    elif not plot:
        _print(flown, forecast(_TABLE_ALTITUDES))


def _altitudes(text: str) -> tuple[float, float]:
    low_m, high_m = map(number_in, text.partition(":")[::2])
    if not _LOWEST_M <= low_m < high_m <= _HIGHEST_M:
        remedy = f"must be LOW:HIGH in metres, ascending, from {_LOWEST_M:g} to {_HIGHEST_M:g}, e.g. 10:12000"
        raise InputError("--altitudes", None, text, remedy)
    return low_m, high_m


def _document(flown: FlightScenario, forecast: DetectionForecast) -> dict[str, object]:
    detection = flown.instrument.detection
    return {
        "scenario": flown.name,
        "instrument": flown.instrument.name,
        "site": flown.site.name,
        "speckle": forecast.speckle,
        "looks": detection.looks,
        "rule": detection.rule,
        "window_loss_db": forecast.window_loss_db,
        "minus_log_pfa_bin": forecast.minus_log_pfa,
        "false_alarm_per_fft": forecast.false_alarm,
        "rows": list(_rows(forecast)),
    }


def _rows(forecast: DetectionForecast) -> Iterator[dict[str, float | None]]:
    """A row per angle and altitude; None where there is no value."""
    for i, angle_deg in enumerate(forecast.angle_deg):
        for j, altitude_m in enumerate(forecast.altitude_m):
            row: dict[str, float | None] = {"angle_deg": float(angle_deg), "altitude_m": float(altitude_m)}
            for name in ("range_m", "snr_db", *_COLUMNS):
                value = float(getattr(forecast, name)[i, j])
                row[name] = value if math.isfinite(value) else None
            yield row


def _print(flown: FlightScenario, forecast: DetectionForecast) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table

    detection = flown.instrument.detection
    fades = "fading echoes" if forecast.speckle else "steady echoes"
    title = f"{flown.instrument.name} over {flown.site.name}, {fades}; probabilities in %"
    table = plain_table(
        "beam\n\n°", "alti-\ntude\nm", "range\n\nm", "SNR\n\ndB", "one\nsegment\nsteady", "\n\nspeckle",
        "meas-\nured\nsteady", "speckle\nown\nfades", "\nshared\nfade", "false\nlock\nsteady", "\n\nspeckle",
        title=title,
    )  # fmt: skip
    for row in _rows(forecast):
        table.add_row(
            *(_number(row[name], ".5g") for name in ("angle_deg", "altitude_m", "range_m")),
            _number(row["snr_db"], ".1f"),
            *(_percent(row[name]) for name in _COLUMNS),
            end_section=row["altitude_m"] == forecast.altitude_m[-1],
        )
    console = PlainConsole()
    console.print(table)
    rule = "all three segments" if detection.rule == "all_three" else "any two segments"
    console.print(
        f"Measured: {rule}, {detection.looks} look(s). Window and straddling loss {forecast.window_loss_db:.2f} dB. "
        f"False alarm per FFT {forecast.false_alarm:.3g}, -ln P_fa of a bin {forecast.minus_log_pfa:.2f}. "
        f"Beyond {detection.maximum_range_m:g} m nothing is valid."
    )


def _number(value: float | None, style: str) -> str:
    return "-" if value is None else format(value, style)


def _percent(probability: float | None) -> str:
    """A percentage: significant digits close to 0, two decimals elsewhere."""
    if probability is None:
        return "-"
    percent = 100.0 * probability
    if percent < 1e-8:
        return "0"
    return f"{percent:.2f}" if percent >= 0.01 else f"{percent:.0e}"

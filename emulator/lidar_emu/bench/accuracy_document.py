"""The accuracy comparison as a JSON document and as points of a plot."""

from __future__ import annotations

import math
from dataclasses import asdict, astuple
from typing import Any

from lidar_emu.bench.accuracy import AccuracyReport, SettingResult
from lidar_emu.bench.errors_against_truth import bias, rms
from lidar_emu.bench.settings import REFERENCE
from lidar_emu.bench.work_precision import pareto_front
from lidar_emu.report.work_precision_plot import Mark


def document(report: AccuracyReport) -> dict[str, Any]:
    """The report as JSON; None where there is no value."""
    front = set(report.front)
    range_m, speed_mps = report.twin
    return {
        "scenario": report.scenario,
        "shots": report.shots,
        "reference": REFERENCE.name,
        "reference_shots": report.reference_shots,
        "waveform_beside_spectral": {
            "beams": report.pairs,
            "range_m": _known(range_m),
            "speed_mps": _known(speed_mps),
        },
        "floor": asdict(report.floor),
        "settings": [_row(result, i in front) for i, result in enumerate(report.results)],
    }


def _row(result: SettingResult, on_front: bool) -> dict[str, Any]:
    spread, error = result.spread, result.error
    values = {
        "time_s": result.time_s,
        "front_s": result.front_s,
        "receiver_s": result.receiver_s,
        "faster_than_waveform": result.waveform_ratio,
        "range_bias_m": None if spread is None else bias(spread.range_m),
        "range_rms_m": None if spread is None else rms(spread.range_m),
        "speed_bias_mps": None if spread is None else bias(spread.speed_mps),
        "speed_rms_mps": None if spread is None else rms(spread.speed_mps),
        "dropout": None if spread is None else spread.dropout,
        "false_lock": None if spread is None else spread.false_lock,
        "range_error_m": None if error is None else error.range_m,
        "speed_error_mps": None if error is None else error.speed_mps,
        "outcome_error": None if error is None else error.outcome,
    }
    return {
        "name": result.setting.name,
        **asdict(result.setting),
        **{name: None if value is None else _known(value) for name, value in values.items()},
        "pareto": on_front,
    }


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def marks(report: AccuracyReport) -> list[list[Mark]]:
    """Points of the plot, for range, speed and outcome; errors below the sampling noise are shown at its level."""
    errors = [astuple(report.resolved_error(result)) for result in report.results]
    return [_marks(report, list(column)) for column in zip(*errors, strict=True)]


def _marks(report: AccuracyReport, errors: list[float]) -> list[Mark]:
    front = set(pareto_front([(r.time_s, error) for r, error in zip(report.results, errors, strict=True)]))
    found = []
    for i, (result, error) in enumerate(zip(report.results, errors, strict=True)):
        setting = result.setting
        family = setting.level if setting.exact else f"{setting.level}, skip rules on"
        label = "" if setting.level == "geometric" else str(setting.beamlets)
        if math.isfinite(error):
            found.append(Mark(family, label, result.time_s, error, i in front))
    return found

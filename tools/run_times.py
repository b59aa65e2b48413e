"""Predicted and measured computing times of runs, as a table: the calibration of `lidar_emu.plan.operations`.

    python tools/run_times.py [CASE ...]

Shipped scenarios are flown whole; extremes are some seconds of the descent, or single shots. Times are processor times,
without start and compilation.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

from lidar_emu.scenario.load import load, shipped_scenarios
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model, measure_whole

_ONE_BEAM = {"scanner": "{pattern: {kind: directions, beams: [[22.5, 0]]}}", "duration_s": "0.05"}
_WAVEFORM = _ONE_BEAM | {"level": "waveform", "instrument.optics.beamlets": "1"}
EXTREMES = {
    "geometric": {"level": "geometric"},
    "127 beamlets": {"instrument.optics.beamlets": "127"},
    "all of exact": {"exact": "true"},
    "linewidth 1 MHz": {"instrument.waveform.linewidth_hz": "1e6", "duration_s": "0.5"},
    "64 looks of a line of 450 bins": _ONE_BEAM
    | {
        "instrument.waveform.linewidth_hz": "1e6",
        "instrument.detection.looks": "64",
        "timing.rate_hz": "10",
    },
    "64 looks": {"instrument.detection.looks": "64", "timing.rate_hz": "10"},
    "waveform": _WAVEFORM,
    "waveform, 127 beamlets": _WAVEFORM | {"instrument.optics.beamlets": "127"},
    "waveform, no poles": _WAVEFORM
    | {"instrument.receiver.bandwidth_hz": "null", "instrument.receiver.ac_coupling_hz": "0"},
    "waveform, AC coupling at 250 Hz": _WAVEFORM | {"instrument.receiver.ac_coupling_hz": "250"},
}
_FLOWN_S = "10"


@dataclass(frozen=True)
class Case:
    """A run."""

    name: str
    scenario: FlightScenario


def cases() -> list[Case]:
    """List shipped flights, and extremes of the descent."""
    flights = []
    for name in shipped_scenarios():
        scenario = load(name)
        if isinstance(scenario, FlightScenario) and scenario.live is None:
            flights.append(Case(name, scenario))
    brief = {"duration_s": _FLOWN_S}
    for name, keys in EXTREMES.items():
        scenario = load("descent.yaml", brief | keys)
        assert isinstance(scenario, FlightScenario)
        flights.append(Case(name, scenario))
    return flights


def main(wanted: list[str]) -> None:
    """Print a row for each case as it is measured."""
    print("| run | shots | predicted s | measured s | ratio | most of it |")
    print("|---|---|---|---|---|---|")
    for case in cases():
        if wanted and case.name not in wanted:
            continue
        model = build_model(case.scenario)
        operations = model.plan.operations
        assert operations is not None
        if operations.total_s < 10.0:
            measure_whole(model)
        start_s = time.process_time()
        measure_whole(model)
        taken_s = time.process_time() - start_s
        predicted_s = operations.total_s
        row = f"| {case.name} | {model.shot_count} | {predicted_s:.2g} | {taken_s:.2g} | {predicted_s / taken_s:.2f} |"
        print(f"{row} {operations.dominant} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

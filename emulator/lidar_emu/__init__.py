"""A hardware-in-the-loop emulator of a multi-beam FMCW Doppler landing lidar.

import lidar_emu

run = lidar_emu.simulate("descent.yaml", seed=1)
run.range_m            # (shots, beams), NaN where a beam has no valid range
run.truth.range_m      # the ground truth
run.to_pandas()        # a row per shot and beam

The names in `__all__` are stable; docs/python.md shows each. Each is imported on first use, because the model takes a
second to load.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lidar_emu._version import __version__

if TYPE_CHECKING:
    from lidar_emu.api import (
        CampaignResults,
        Ground,
        detection_by_altitude,
        plan_run,
        record_geometry,
        run_campaign,
        shot_spectra,
        simulate,
    )
    from lidar_emu.embedded_device import EmbeddedDevice
    from lidar_emu.errors import InputError as InputError
    from lidar_emu.errors import RunError as RunError
    from lidar_emu.inertial_unit import ImuErrors, simulate_imu
    from lidar_emu.inertial_unit import ImuSamples as ImuSamples
    from lidar_emu.measurement import GroundTruth as GroundTruth
    from lidar_emu.measurement import Measurement as Measurement
    from lidar_emu.receiver.custom_detection import SegmentSpectrum as SegmentSpectrum
    from lidar_emu.receiver.returns import Reason
    from lidar_emu.recording.read import read_recording as read_recording
    from lidar_emu.scenario.load import load as load
    from lidar_emu.scenario.load import shipped_scenarios as shipped_scenarios
    from lidar_emu.scenario.schema import BenchScenario as BenchScenario
    from lidar_emu.scenario.schema import FlightScenario as FlightScenario

_HOMES = {
    "BenchScenario": "scenario.schema",
    "CampaignResults": "api",
    "EmbeddedDevice": "embedded_device",
    "FlightScenario": "scenario.schema",
    "Ground": "api",
    "GroundTruth": "measurement",
    "ImuErrors": "inertial_unit",
    "ImuSamples": "inertial_unit",
    "InputError": "errors",
    "Measurement": "measurement",
    "Reason": "receiver.returns",
    "RunError": "errors",
    "SegmentSpectrum": "receiver.custom_detection",
    "detection_by_altitude": "api",
    "load": "scenario.load",
    "plan_run": "api",
    "read_recording": "recording.read",
    "record_geometry": "api",
    "run_campaign": "api",
    "shipped_scenarios": "scenario.load",
    "shot_spectra": "api",
    "simulate": "api",
    "simulate_imu": "inertial_unit",
}
__all__ = [
    "BenchScenario",
    "CampaignResults",
    "EmbeddedDevice",
    "FlightScenario",
    "Ground",
    "GroundTruth",
    "ImuErrors",
    "ImuSamples",
    "InputError",
    "Measurement",
    "Reason",
    "RunError",
    "SegmentSpectrum",
    "__version__",
    "detection_by_altitude",
    "load",
    "plan_run",
    "read_recording",
    "record_geometry",
    "run_campaign",
    "shipped_scenarios",
    "shot_spectra",
    "simulate",
    "simulate_imu",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    found = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})

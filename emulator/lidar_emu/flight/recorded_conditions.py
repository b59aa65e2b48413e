"""The scenario keys on which a recorded geometry depends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.faults.physics import Misalignment
from lidar_emu.scenario.schema import FlightScenario

_OF_LIGHT = ("name", "surface.lommel_seeliger_share", "atmosphere", "sunlight_w_per_m2_um")
"""Keys of a site that do not affect its geometry. Reflectance counts as geometry: it is recorded with each hit."""

_ABSENT = "nothing"


def conditions(scenario: FlightScenario) -> dict[str, Any]:
    """List the keys and JSON values on which a scenario's geometry depends.

    A file counts by its name without its folder: the recording holds the geometry of its contents at that time.
    """
    instrument, tree = scenario.instrument, scenario.model_dump(mode="json")
    tilts = {place: fault for place, fault in enumerate(scenario.faults) if isinstance(fault, Misalignment)}
    parts = {
        "timing": {"rate_hz": scenario.timing.rate_hz},
        "instrument": {
            "waveform": {
                "wavelength_m": instrument.waveform.wavelength_m,
                "segment_time_s": instrument.waveform.segment_time_s,
                "fft_length / sample_rate_hz": instrument.waveform.record_time_s,
            },
            "optics": {"waist_radius_m": instrument.optics.waist_radius_m},
            "detection": {"looks": instrument.detection.looks},
        },
        "scanner": tree["scanner"],
        "mounting": tree["mounting"],
        "trajectory": tree["trajectory"],
        "site": tree["site"],
        "faults": {str(place): fault.model_dump(mode="json") for place, fault in tilts.items()},
    }
    if any(fault.probability < 1 for fault in tilts.values()):
        parts["seed"] = scenario.seed  # determines when they act
    of_light = tuple(f"site.{key}" for key in _OF_LIGHT)
    return {key: value for key, value in _leaves(parts) if not key.startswith(of_light)}


def require_same(scenario: FlightScenario, recorded: dict[str, Any], file: str) -> None:
    """Refuse a scenario with a different geometry.

    Raises:
        InputError: names the first key that differs.
    """
    current = conditions(scenario)
    for key in [*current, *(key for key in recorded if key not in current)]:
        here, there = current.get(key, _ABSENT), recorded.get(key, _ABSENT)
        if here != there:
            if here is _ABSENT:
                raise InputError(scenario.name, key, Finding("missing"), f"state {there}, as in {file}")
            remedy = f"leave it out, as in {file}" if there is _ABSENT else f"must be {there}, as in {file}"
            raise InputError(scenario.name, key, here, remedy)


def _leaves(tree: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys and values of nested mappings; a list is a value unless it holds mappings."""
    if isinstance(tree, list) and any(isinstance(item, dict) for item in tree):
        tree = {str(place): item for place, item in enumerate(tree)}
    if isinstance(tree, dict):
        for name, value in tree.items():
            yield from _leaves(value, f"{key}.{name}" if key else name)
    elif tree is not None:
        is_file = key.endswith(".file") and isinstance(tree, str)
        yield key, Path(tree).name if is_file else tree

"""What a recorded geometry depends on, key by key."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.faults import Misalignment
from lidar_emu.scenario.schema import FlightScenario

_OF_LIGHT = ("name", "surface.lommel_seeliger_share", "atmosphere", "sunlight_w_per_m2_um")
"""What of a site is none of its geometry. Reflectance is: it belongs to the places that are hit."""

_ABSENT = "nothing"


def conditions(scenario: FlightScenario) -> dict[str, Any]:
    """All that a scenario's geometry depends on, as JSON knows it, by key.

    Of files that it names the name counts, not the folder: what was recorded is what they held then.
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
        parts["seed"] = scenario.seed  # which says when they act
    of_light = tuple(f"site.{key}" for key in _OF_LIGHT)
    return {key: value for key, value in _leaves(parts) if not key.startswith(of_light)}


def require_same(scenario: FlightScenario, recorded: dict[str, Any], file: str) -> None:
    """Refuse a scenario whose geometry would be another.

    Raises:
        InputError: a key differs; names the first.
    """
    asked = conditions(scenario)
    for key in [*asked, *(key for key in recorded if key not in asked)]:
        here, there = asked.get(key, _ABSENT), recorded.get(key, _ABSENT)
        if here != there:
            found = Finding("nothing given") if here is _ABSENT else here
            raise InputError(scenario.name, key, found, f"allowed: {there}, as recorded in {file}")


def _leaves(tree: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """The values of nested mappings by their keys; lists are values, unless they hold mappings."""
    if isinstance(tree, list) and any(isinstance(item, dict) for item in tree):
        tree = {str(place): item for place, item in enumerate(tree)}
    if isinstance(tree, dict):
        for name, value in tree.items():
            yield from _leaves(value, f"{key}.{name}" if key else name)
    elif tree is not None:
        is_file = key.endswith(".file") and isinstance(tree, str)
        yield key, Path(tree).name if is_file else tree

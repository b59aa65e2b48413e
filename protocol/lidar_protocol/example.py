"""One shot that shows every kind of value: the example of the interface document and of the golden frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from lidar_protocol.fields import Value

UNIT: Final = 0

HEADER: Final[Mapping[str, Value]] = {
    "time_ns": 1_500_490_773,
    "due_ns": 1_502_900_000,
    "mode": 4,
    "laser_on": True,
    "clock_locked": True,
    "shot": 30,
}

_MEASURED: Final[Mapping[str, Value]] = {
    "fired": True,
    "range_valid": True,
    "speed_valid": True,
    "sign_resolved": True,
    "segments": 7,
    "reason": 0,
    "returns": 1,
    "snr_db": 34.25,
    "range_m": 2164.784,
    "closing_speed_mps": 92.388,
    "second_range_m": None,
    "sigma_range_m": 0.1401,
    "sigma_speed_mps": 0.00102,
    "residual_mps": -0.0012,
    "beam_angle_deg": 22.5,
    "time_offset_s": 0.0,
}
_NO_MEASUREMENT: Final[Mapping[str, Value]] = {
    "range_valid": False,
    "speed_valid": False,
    "sign_resolved": False,
    "segments": 0,
    "returns": 0,
    "snr_db": None,
    "range_m": None,
    "closing_speed_mps": None,
    "sigma_range_m": None,
    "sigma_speed_mps": None,
    "residual_mps": None,
}

BEAMS: Final[tuple[Mapping[str, Value], ...]] = (
    _MEASURED,
    {
        **_MEASURED,
        "closing_speed_mps": -46.194,
        "returns": 2,
        "second_range_m": 2171.5,
        "time_offset_s": 0.0009,
    },
    {**_MEASURED, **_NO_MEASUREMENT, "segments": 5, "reason": 3, "snr_db": 11.5, "time_offset_s": 0.0018},
    {
        **_MEASURED,
        **_NO_MEASUREMENT,
        "fired": False,
        "reason": 1,
        "beam_angle_deg": None,
        "time_offset_s": None,
    },
)
"""A measurement; one of a receding surface with a second return; an echo below the threshold; not fired."""

"""What each viewer shows of a flight: the quantities plotted, and where the scene is looked at from."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.ground_below import Extent

LATENESS = "lateness_us"
POINTS_S = 10.0
"""Points of these last seconds are shown."""
_PLOTS = {
    "range_m": "Range (m)",
    "closing_speed_mps": "Closing speed (m/s)",
    "range_error_m": "Range error (m)",
    "closing_speed_error_mps": "Closing speed error (m/s)",
    LATENESS: "Lateness (us)",
}
_FROM_CENTRE = np.array([-0.55, -0.9, 0.25])
_BEAMS_RGB = ("#4e98e2", "#f5774d", "#f7df71", "#5cd6a9", "#b073d9", "#e2669b", "#8fa3ad", "#a9d55c")


def plots(keeps_time: bool) -> dict[str, str]:
    """Titles of the quantities plotted, by name; without deadlines of the packets there is no lateness."""
    return {name: title for name, title in _PLOTS.items() if keeps_time or name != LATENESS}


def beam_rgb(beam: int) -> str:
    """Colour of a beam's curves; the ninth has the first's again."""
    return _BEAMS_RGB[beam % len(_BEAMS_RGB)]


def size_m(extent: Extent) -> float:
    """Longest side of the box."""
    return float((extent.high_m - extent.low_m).max())


def centre_and_eye_m(extent: Extent) -> tuple[FloatArray, FloatArray]:
    """Centre of the box, and a point south-west of it and a little above, from which the whole flight is seen."""
    centre_m = (extent.low_m + extent.high_m) / 2
    return centre_m, centre_m + size_m(extent) * _FROM_CENTRE

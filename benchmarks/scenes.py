"""Levels that the Monte Carlo tables compare, and keys of scenarios that fly beams steadily over level ground."""

from __future__ import annotations

REFERENCE = {"level": "reference"}
FAST_LEVELS: dict[str, dict[str, str]] = {"spectral": {}}


def scanner(tilt_deg: float, *azimuths_deg: float) -> str:
    """Beams at an angle off nadir; one forward if no azimuth is given."""
    beams = ", ".join(f"[{tilt_deg}, {azimuth_deg}]" for azimuth_deg in azimuths_deg or (0,))
    return f"{{pattern: {{kind: directions, beams: [{beams}]}}}}"


def trajectory(
    altitude_m: float, half_m: float, speed_mps: float, change_mps: float = 0.0, more: str = ""
) -> str:
    """A flight through an altitude, from `half_m` above to `half_m` below.

    Args:
        altitude_m: altitude in the middle.
        half_m: half of the way down.
        speed_mps: speed in the middle.
        change_mps: loss of speed from the middle to the end: a quantised speed is then anywhere in its bin.
        more: other keys of the trajectory, in the flow style of YAML.
    """
    waypoints = ", ".join(
        f"{{altitude_m: {altitude_m + side * half_m}, speed_mps: {speed_mps + side * change_mps}}}"
        for side in (1, -1)
    )
    return f"{{kind: profile, waypoints: [{waypoints}]{', ' + more if more else ''}}}"

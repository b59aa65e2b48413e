"""All rays that a flight may cast with any of its beam patterns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.vector_arrays import rotate
from lidar_emu.scanner.footprint import beamlet_pattern
from lidar_emu.scanner.model import ScannerModel
from lidar_emu.scenario.faults.physics import Misalignment
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.ray_reach import Lines
from lidar_emu.trajectory.state import Trajectory, seconds

MOST_SHOTS = 1_000_000
"""Longer flights are not swept: the sweep would take longer than it saves."""
_SHOTS_AT_ONCE = 4096


def sweep(
    trajectory: Trajectory,
    shots: int,
    period_ns: int,
    validity_ns: IntArray,
    lever_arm_body_m: FloatArray,
    scanner: ScannerModel,
    true_body: FloatArray,
) -> Iterator[Lines]:
    """Yield the axes of all beams of all patterns at each beam's time of validity, block by block.

    The first ray of a shot starts at the sensor's position at the start of the shot, and has no direction.

    Args:
        trajectory: known for the whole flight.
        shots: number of shots.
        period_ns: time from shot to shot.
        validity_ns: (beams,) Time of validity of each beam from the shot's start.
        lever_arm_body_m: (3,) Position of the sensor.
        scanner: scanner with its patterns.
        true_body: (rows, beams, 3) True beam directions, in the scanner's order; NaN where a pattern has fewer beams.
    """
    after_ns = np.concatenate([[0], validity_ns])
    for first in range(0, shots, _SHOTS_AT_ONCE):
        shot = np.arange(first, min(first + _SHOTS_AT_ONCE, shots), dtype=np.int64)
        vehicle = trajectory.state(seconds(shot[:, None] * period_ns + after_ns).reshape(-1))
        sensor_site_m = vehicle.position_site_m + rotate(vehicle.site_from_body, lever_arm_body_m)
        body = np.full((len(shot), len(after_ns), 3), np.nan)
        for pattern in range(scanner.set_count):
            body[:, 1:] = true_body[scanner.row(pattern, shot)]
            yield sensor_site_m, rotate(vehicle.site_from_body, body.reshape(-1, 3))


def beamlet_margins(scenario: FlightScenario) -> tuple[float, float]:
    """Bound the angle between beamlets and the beam axis, in radians, and the offset of their origins, in metres.

    A beamlet's ray joins points of equal relative power, so it diverges no faster than the far field. Misalignments
    that the scenario injects may add up.
    """
    waist_m = scenario.instrument.optics.waist_radius_m
    beamlets = scenario.instrument.optics.beamlets
    # The plan may use more; from 19 on all patterns fill the same disc.
    offset_w, _ = beamlet_pattern(max(beamlets, 19) if beamlets > 1 else 1)
    farthest_w = float(np.sqrt(np.max(np.sum(offset_w**2, axis=1))))
    far_field = scenario.instrument.waveform.wavelength_m / (np.pi * waist_m)
    tilts_mrad = [fault.tilt_mrad for fault in scenario.faults if isinstance(fault, Misalignment)]
    tilt_rad = 1e-3 * sum(float(np.hypot(*tilt)) for tilt in tilts_mrad)
    return farthest_w * far_field + tilt_rad + 1e-9, farthest_w * waist_m + 1e-6

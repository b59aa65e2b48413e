"""Generate the shipped elevation grid: two kilometres of a lunar mare.

    python tools/make_ground.py emulator/lidar_emu/shipped/ground/mare.npz

Gentle undulations, and about as many degraded craters as on an old mare surface. Only additions, products
and square roots of seeded random numbers are used, so that the file is the same wherever it is made. At its
rim the ground fades to the height of its centre, so that a level plane continues it without a step.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

SEED = 20240117
SAMPLES = 513
PIXEL_M = 4.0
ELEVATION_M = -1350.0
STEP_M = 1 / 256
RIM_M = 96.0

LONGEST_WAVE_M = 1024.0
WAVE_HEIGHT_M = 5.0
SHORTEST_WAVE_M = 16.0
HALF_WAVE_HEIGHT = 0.6

SMALLEST_CRATER_M = 12.0
LARGEST_CRATER_M = 220.0
CRATERS_PER_M2 = 0.079
FRESH_DEPTH = 0.2
RIM_HEIGHT = 0.036


def undulations(rng: np.random.Generator) -> np.ndarray:
    """Waves of falling length, each half as long as the one before and HALF_WAVE_HEIGHT as high."""
    extent_m = (SAMPLES - 1) * PIXEL_M
    height = np.zeros((SAMPLES, SAMPLES))
    length_m = LONGEST_WAVE_M
    amplitude_m = WAVE_HEIGHT_M
    while length_m >= SHORTEST_WAVE_M:
        knots = int(extent_m / length_m) + 1
        height += amplitude_m * smooth(rng.random((knots + 1, knots + 1)) - 0.5, length_m)
        length_m /= 2
        amplitude_m *= HALF_WAVE_HEIGHT
    return height


def smooth(knots: np.ndarray, length_m: float) -> np.ndarray:
    """Values at knots, joined with continuous slope."""
    place = np.arange(SAMPLES) * PIXEL_M / length_m
    index = np.minimum(place.astype(int), len(knots) - 2)
    share = ramp(place - index)
    rows = knots[index] * (1 - share)[:, None] + knots[index + 1] * share[:, None]
    return rows[:, index] * (1 - share) + rows[:, index + 1] * share


def ramp(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 with level ends."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def craters(rng: np.random.Generator) -> np.ndarray:
    """Craters of a surface in equilibrium: 0.079 / D² per square metre are larger than D (Trask 1966)."""
    extent_m = (SAMPLES - 1) * PIXEL_M
    smallest, largest = 1 / SMALLEST_CRATER_M**2, 1 / LARGEST_CRATER_M**2
    count = int(CRATERS_PER_M2 * (smallest - largest) * extent_m**2)
    diameter_m = 1 / np.sqrt(largest + (smallest - largest) * rng.random(count))
    centre_m = extent_m * rng.random((count, 2))
    # Most craters are worn down: the cube leaves few that are fresh.
    freshness = 0.08 + 0.62 * rng.random(count) ** 3
    height = np.zeros((SAMPLES, SAMPLES))
    for k in range(count):
        add_crater(height, centre_m[k], diameter_m[k] / 2, freshness[k])
    return height


def add_crater(height: np.ndarray, centre_m: np.ndarray, radius_m: float, freshness: float) -> None:
    """A parabolic bowl, a raised rim, and ejecta that thin out with the cube of the distance."""
    reach = 3 * radius_m
    first = np.maximum(np.ceil((centre_m - reach) / PIXEL_M), 0).astype(int)
    last = np.minimum(np.floor((centre_m + reach) / PIXEL_M), SAMPLES - 1).astype(int)
    north = (np.arange(first[0], last[0] + 1) * PIXEL_M - centre_m[0]) / radius_m
    east = (np.arange(first[1], last[1] + 1) * PIXEL_M - centre_m[1]) / radius_m
    distance = np.sqrt(north[:, None] * north[:, None] + east * east)
    depth_m = FRESH_DEPTH * 2 * radius_m * freshness
    rim_m = RIM_HEIGHT * 2 * radius_m * freshness
    bowl = (depth_m + rim_m) * distance * distance - depth_m
    outward = np.maximum(distance, 1.0)
    ejecta = rim_m / (outward * outward * outward) * (1 - ramp((outward - 1) / 2))
    height[first[0] : last[0] + 1, first[1] : last[1] + 1] += np.where(distance < 1, bowl, ejecta)


def faded(height: np.ndarray) -> np.ndarray:
    """Blend the ground into the height of its centre along the rim, and shift the centre to 0."""
    from_edge = np.minimum(np.arange(SAMPLES), np.arange(SAMPLES)[::-1]) * PIXEL_M
    inward = ramp(from_edge / RIM_M)
    return (height - height[SAMPLES // 2, SAMPLES // 2]) * inward[:, None] * inward


def mare() -> np.ndarray:
    """(rows from north to south, columns) elevation above the datum, in steps of STEP_M."""
    rng = np.random.Generator(np.random.PCG64(SEED))
    height = undulations(rng) + craters(rng)
    return (np.round((faded(height) + ELEVATION_M) / STEP_M) * STEP_M).astype(np.float32)


if __name__ == "__main__":
    half_m = (SAMPLES - 1) / 2 * PIXEL_M
    np.savez_compressed(
        Path(sys.argv[1]),
        elevation_m=mare(),
        pixel_m=np.float64(PIXEL_M),
        map_x_m=np.float64(-half_m),
        map_y_m=np.float64(half_m),
    )

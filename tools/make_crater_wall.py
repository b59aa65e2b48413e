"""Generate the shipped crater wall: a plateau, a step of three kilometres, and the floor on which the origin lies.

    python tools/make_crater_wall.py emulator/lidar_emu/shipped/ground/crater_wall.npz

It follows a formula and represents no real place. Rows run from north to south, the map's zero is the site's origin;
elevations are in decimetres.
"""

from __future__ import annotations

import sys

import numpy as np

PIXEL_M = 50.0
WEST_M, EAST_M, SOUTH_M, NORTH_M = -3000.0, 3000.0, -12_000.0, 3000.0
STEP_M = 3000.0
WALL_FOOT_M, WALL_TOP_M = -4900.0, -6000.0
"""North of the origin: the plateau lies in the south."""


def elevation_m(east_m: np.ndarray, north_m: np.ndarray) -> np.ndarray:
    """Plateau and floor with a smooth wall between, and gentle hills on both."""
    share = np.clip((WALL_FOOT_M - north_m) / (WALL_FOOT_M - WALL_TOP_M), 0.0, 1.0)
    wall_m = STEP_M * share * share * (3.0 - 2.0 * share)
    hills_m = 4.0 * np.sin(east_m / 310.0) * np.cos(north_m / 270.0) + 2.0 * np.cos(
        east_m / 90.0 + north_m / 130.0
    )
    return wall_m + hills_m


def main(path: str) -> None:
    """Write the grid."""
    east_m = np.arange(WEST_M, EAST_M + PIXEL_M / 2, PIXEL_M)
    north_m = np.arange(NORTH_M, SOUTH_M - PIXEL_M / 2, -PIXEL_M)
    heights_m = elevation_m(east_m[None, :], north_m[:, None])
    np.savez_compressed(
        path,
        elevation_m=np.rint(10.0 * heights_m).astype(np.int16),
        pixel_m=PIXEL_M,
        map_x_m=WEST_M,
        map_y_m=NORTH_M,
    )


if __name__ == "__main__":
    main(sys.argv[1])

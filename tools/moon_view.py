"""The ground of a scenario as a camera sees it: cast by `lidar_emu.Ground`, in the light of a low sun."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

import lidar_emu

WIDTH, HEIGHT = 720, 405
CENTRE_X, CENTRE_Y, FOCAL_PX = 240.0, 196.0, 480.0
SUN = np.array([-0.94, -0.26, 0.2]) / np.linalg.norm([-0.94, -0.26, 0.2])
"""Direction to the sun, in the site frame."""
TILE_HALF_M = 896.0
"""Half of the side of the square that repeats: the map without its border, which sinks to the level plane."""


class Relief:
    """Slopes and cast shadows of a square that repeats, at halved resolutions for distant pixels."""

    def __init__(self, height_m: np.ndarray, pixel_m: float) -> None:
        self.pixel_m = pixel_m
        slope = [np.roll(height_m, -1, axis) - np.roll(height_m, 1, axis) for axis in (1, 0)]
        layers = [slope[0] / (2 * pixel_m), slope[1] / (2 * pixel_m), self._lit(height_m)]
        self.levels = [np.stack(layers)]
        while self.levels[-1].shape[1] % 2 == 0:
            last = self.levels[-1]
            self.levels.append(
                last.reshape(3, last.shape[1] // 2, 2, last.shape[2] // 2, 2).mean(axis=(2, 4))
            )

    def _lit(self, height_m: np.ndarray) -> np.ndarray:
        """How far each pixel is in the sun, 0 to 1: the ground towards the sun hides it step by step."""
        ahead = SUN[:2] / np.abs(SUN[:2]).max()
        rise_m = self.pixel_m * np.hypot(*ahead) * SUN[2] / np.hypot(*SUN[:2])
        hidden_m = np.full_like(height_m, -np.inf)
        for step in range(1, int((height_m.max() - height_m.min()) / rise_m) + 2):
            shift = (round(-step * ahead[1]), round(-step * ahead[0]))
            hidden_m = np.maximum(hidden_m, np.roll(height_m, shift, (0, 1)) - step * rise_m)
        lit: np.ndarray = np.clip(0.5 - (hidden_m - height_m) / (1.5 * rise_m), 0.0, 1.0)
        return lit

    def at(self, east_m: np.ndarray, north_m: np.ndarray, pixel_m: np.ndarray) -> np.ndarray:
        """East slope, north slope and light at points, averaged over what a pixel of the picture covers."""
        level = np.clip(np.log2(np.maximum(pixel_m / self.pixel_m, 1e-3)), 0, len(self.levels) - 1.001)
        found = np.zeros((3, len(east_m)))
        for index, layers in enumerate(self.levels):
            weight = np.maximum(0.0, 1.0 - np.abs(level - index))
            used = weight > 0
            size_m = self.pixel_m * 2**index
            where = np.stack([north_m[used], east_m[used]]) / size_m - 0.5
            for layer, values in zip(layers, found, strict=True):
                values[used] += weight[used] * map_coordinates(layer, where, order=1, mode="grid-wrap")
        return found


def cratered(size: int, pixel_m: float, count: int, largest_m: float, seed: int) -> Relief:
    """Small craters, many of which are small and worn, on a square that repeats."""
    rng = np.random.default_rng(seed)
    height_m = np.zeros((size, size))
    for _ in range(count):
        radius_m = largest_m / 2 * rng.uniform(0.012, 1.0) ** 0.6 * rng.uniform(0.15, 1.0)
        reach = min(size // 2, int(2.2 * radius_m / pixel_m) + 2)
        axis = np.arange(-reach, reach) * pixel_m / radius_m
        distance = np.hypot(axis[None, :], axis[:, None])
        bowl = np.where(distance < 1, 0.32 * distance**2 - 0.26, 0.06 * np.exp(-4 * (distance - 1)))
        rows, columns = ((rng.integers(size) + np.arange(2 * reach)) % size for _ in range(2))
        height_m[np.ix_(rows, columns)] += rng.uniform(0.1, 0.8) ** 1.5 * radius_m * bowl
    rough = sum(gaussian_filter(rng.normal(size=(size, size)), s, mode="wrap") * s**1.6 for s in (1, 2, 4, 8))
    return Relief(height_m + 0.07 * pixel_m * rough, pixel_m)


class Moon:
    """The ground of the scenario, seen from anywhere."""

    def __init__(self, scenario: Any) -> None:
        self.ground = lidar_emu.Ground(scenario)
        axis_m = np.arange(1.0, 2 * TILE_HALF_M, 2.0) - TILE_HALF_M
        height_m = gaussian_filter(
            self.ground.height_m(axis_m[None, :], axis_m[:, None]), 1.2, mode="nearest"
        )
        # Mirrored, so that it repeats without an edge.
        height_m = np.block([[height_m, height_m[:, ::-1]], [height_m[::-1], height_m[::-1, ::-1]]])
        self.reliefs = [
            Relief(height_m, 2.0),
            cratered(1024, 0.25, 900, 9.0, 5),
            cratered(1024, 0.04, 700, 1.8, 6),
        ]
        self.shade = gaussian_filter(np.random.default_rng(7).normal(size=(256, 256)), 6, mode="wrap") * 12

    def picture(self, camera: Camera) -> np.ndarray:
        """Brightness of each pixel, 0 to 1."""
        rays = camera.rays()
        hits = self.ground.cast(camera.eye_m, rays)
        distance_m = hits.range_m.ravel()
        seen = np.isfinite(distance_m)
        point_m, distance_m = hits.point_site_m.reshape(-1, 3)[seen], distance_m[seen]
        sine = np.clip(-rays.reshape(-1, 3)[seen, 2], 0.02, 1.0)
        covered_m = distance_m / FOCAL_PX / np.sqrt(sine)
        sky = np.zeros(len(seen))
        sky[seen] = self._brightness(point_m, covered_m, camera.toward) * self._fade(
            distance_m / camera.reach_m
        )
        return sky.reshape(HEIGHT, WIDTH)

    def _brightness(self, point_m: np.ndarray, covered_m: np.ndarray, toward: np.ndarray) -> np.ndarray:
        """Lommel-Seeliger's law on the slopes, with a little light in the shadows."""
        east_m, north_m = point_m[:, 0], point_m[:, 1]
        layers = [
            relief.at(east_m + TILE_HALF_M, north_m + TILE_HALF_M, covered_m) for relief in self.reliefs
        ]
        slope_east, slope_north, _ = sum(layers)
        length = np.sqrt(1 + slope_east**2 + slope_north**2)
        sun = np.clip((SUN[2] - slope_east * SUN[0] - slope_north * SUN[1]) / length, 0, None)
        view = np.clip((-toward[2] + slope_east * toward[0] + slope_north * toward[1]) / length, 0.15, None)
        lit = np.prod([layer[2] for layer in layers], axis=0)
        mare = map_coordinates(self.shade, np.stack([north_m, east_m]) / 23.0, order=1, mode="grid-wrap")
        return np.asarray((0.02 + 1.5 * lit * sun / (sun + view)) * (1 + 0.1 * mare))

    @staticmethod
    def _fade(distance: np.ndarray) -> np.ndarray:
        return np.asarray(0.12 + 0.88 * np.exp(-((distance / 3.2) ** 2)))


class Camera(NamedTuple):
    """A camera with its axes in the site frame."""

    eye_m: np.ndarray
    right: np.ndarray
    down: np.ndarray
    toward: np.ndarray
    reach_m: float

    @classmethod
    def aimed(cls, target_m: np.ndarray, reach_m: float, heading_deg: float, pitch_deg: float) -> Camera:
        """Camera at a distance from its target."""
        heading, pitch = np.radians([heading_deg, pitch_deg])
        toward = np.array([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), -np.sin(pitch)])
        right = np.array([np.cos(heading), -np.sin(heading), 0.0])
        return cls(target_m - reach_m * toward, right, np.cross(toward, right), toward, reach_m)

    def rays(self) -> np.ndarray:
        """(rows, columns, 3) directions of all pixels."""
        x = (np.arange(WIDTH) + 0.5 - CENTRE_X)[None, :, None] / FOCAL_PX
        y = (np.arange(HEIGHT) + 0.5 - CENTRE_Y)[:, None, None] / FOCAL_PX
        rays = self.toward + x * self.right + y * self.down
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))

    def pixels(self, point_m: np.ndarray) -> np.ndarray:
        """(..., 2) columns and rows at which points are seen; NaN behind the camera."""
        ray = point_m - self.eye_m
        depth = ray @ self.toward
        depth = np.where(depth > 0.05, depth, np.nan)
        across = np.stack([ray @ self.right, ray @ self.down], axis=-1)
        return np.asarray([CENTRE_X, CENTRE_Y] + FOCAL_PX * across / depth[..., None])

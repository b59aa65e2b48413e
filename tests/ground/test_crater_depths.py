"""Depths measured on a generated grid, against craters of known depth."""

import numpy as np
import pytest
from parts_of_ground import CRATERS

from lidar_emu.scene.procedural.compare import depths_on_the_grid
from lidar_emu.scene.procedural.populations import CraterField, Population


def test_depth_is_the_height_of_the_rim_above_the_centre(ground):
    """Paraboloids, of which the circle of the rim is higher than the centre by the square of its radius."""
    generated = ground(craters=CRATERS, size_m=64.0, spacing_m=0.25)
    north_m, east_m = np.meshgrid(
        *[np.arange(32.0, -32.01, -0.25), np.arange(-32.0, 32.01, 0.25)], indexing="ij"
    )
    height_m = (east_m - 5.0) ** 2 + (north_m + 3.0) ** 2
    population = Population(np.array([20.0, 20.0, 0.5]), np.array([5.0, 25.0, 5.0]), np.full(3, -3.0))
    depth_m = depths_on_the_grid(generated, height_m, CraterField(population, np.zeros(3)))
    assert depth_m[0] == pytest.approx(100.0, abs=0.02)
    assert np.isnan(depth_m[1:]).all(), "near the edge, and small"

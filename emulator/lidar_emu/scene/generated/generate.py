"""Generation of a ground's elevations from its parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.random_streams import CRATERS, RELIEF, ROCKS, generator
from lidar_emu.scenario.generated_ground import Generated, Relief
from lidar_emu.scene.generated.craters import CraterField, crater_layer, scatter_craters
from lidar_emu.scene.generated.relief import fractional_surface
from lidar_emu.scene.generated.rocks import RockField, rock_layer, scatter_rocks
from lidar_emu.scene.generated.statistics import rms_slope


@dataclass(frozen=True)
class Layers:
    """A ground and its layers, in metres: (rows from north to south, columns from west to east)."""

    relief_m: FloatArray | None
    """Zero-mean relief; None for level ground."""
    craters: CraterField | None
    """Positions and sizes of the craters."""
    crater_m: FloatArray | None
    """Height that the craters add."""
    rocks: RockField | None
    """Positions and sizes of the rocks."""
    rock_m: FloatArray | None
    """Height that the rocks add."""

    def elevation_m(self, ground: Generated) -> npt.NDArray[np.float32]:
        """Sum of the layers, rounded as in the cache, so that a generated ground equals one that is read."""
        total = np.zeros((ground.cells + 1, ground.cells + 1))
        for layer in (self.relief_m, self.crater_m, self.rock_m):
            if layer is not None:
                total += layer
        return total.astype(np.float32)


def generate(ground: Generated) -> Layers:
    """Generate a ground; parameters, seed and the versions of numpy and scipy determine its bits."""
    relief_m = None if ground.relief is None else _relief(ground, ground.relief)
    craters = crater_m = rocks = rock_m = None
    if ground.craters is not None:
        craters = scatter_craters(ground, ground.craters, generator(ground.seed, CRATERS))
        crater_m = crater_layer(ground, ground.craters, craters)
    if ground.rocks is not None:
        rocks = scatter_rocks(ground, ground.rocks, generator(ground.seed, ROCKS))
        rock_m = rock_layer(ground, rocks)
    return Layers(relief_m, craters, crater_m, rocks, rock_m)


def _relief(ground: Generated, relief: Relief) -> FloatArray:
    """Relief scaled to the requested slope.

    On a smooth surface much of the slope is in waves as long as the square, and differs by tens of per cent between
    realisations; therefore the slope of *this* realisation is scaled to the requested one.
    """
    surface = fractional_surface(ground.cells + 1, relief.hurst, generator(ground.seed, RELIEF))
    now = rms_slope(surface, ground.spacing_m, relief.baseline_m, relief.hurst)
    return np.asarray(surface * (math.tan(math.radians(relief.rms_slope_deg)) / now), dtype=np.float64)

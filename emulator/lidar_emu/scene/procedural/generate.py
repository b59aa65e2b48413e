"""Generation of a ground's elevations from its parameters.

Heights at points r apart differ by a Gaussian of variance s² r^2H. Stein (2002), "Fast and exact simulation of
fractional Brownian surfaces", adds a parabola to that variogram, which makes it the variogram of a stationary field
with compact covariance; such a field is exact on a sufficiently large torus, and a random tilt removes the parabola
again. Less than half of the torus is kept, so that opposite edges are independent.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from tokenize import TokenError
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from lidar_emu.errors import InputError, RunError
from lidar_emu.files import cache_folder, whole_file
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.random_streams import CRATERS, RELIEF, ROCKS, generator
from lidar_emu.scenario import ground as generated_ground
from lidar_emu.scenario.ground import Generated, Relief
from lidar_emu.scene.procedural.populations import (
    CraterField,
    RockField,
    crater_layer,
    rock_layer,
    scatter_craters,
    scatter_rocks,
)

_ROWS_AT_ONCE = 64
"""Rows transformed at once: enough for speed, without holding the whole torus in memory."""
_ROUGH_REACH, _SMOOTH_REACH = 1.0, 1.5
"""Distance at which the covariance ends, in sides of the square, for H up to 3/4 and above. Stein has 2 for the latter;
from 1.4 on the spectrum was nonnegative on every grid tried."""


def fractional_surface(side: int, hurst: float, rng: np.random.Generator) -> FloatArray:
    """Draw a fractional Brownian surface on a square grid.

    Args:
        side: samples per side.
        hurst: H, above 0 and below 1.
        rng: random generator.

    Returns:
        Heights (side, side) of mean 0. Points r apart, in units of the square's side and at most 1, differ by the
        variance 2 r^2H before the mean is subtracted, which does not change differences.
    """
    spectrum, parabola = torus_spectrum(side, hurst)
    height = _field(spectrum, side, rng)
    tilt = rng.standard_normal(2) * math.sqrt(2 * parabola)
    place = np.arange(side) / (side - 1)
    height += tilt[0] * place[:, None] + tilt[1] * place
    return np.asarray(height - height.mean(), dtype=np.float64)


def torus_spectrum(side: int, hurst: float) -> tuple[FloatArray, float]:
    """Eigenvalues of the covariance on the torus, and the coefficient of the parabola added to the variogram.

    Returns:
        (m + 1, m + 1) of one quadrant, symmetric, for a torus of 2 m by 2 m samples; and c in 2 r^2H - 2 c r².
    """
    from scipy import fft

    reach = _ROUGH_REACH if hurst <= 0.75 else _SMOOTH_REACH
    half = fft.next_fast_len(math.ceil(reach * (side - 1)), real=True)
    distance = np.arange(half + 1) / (side - 1)
    covariance, parabola = _covariance(np.hypot(distance[:, None], distance), 2 * hurst, reach)
    return np.maximum(fft.dctn(covariance, type=1, overwrite_x=True), 0.0), parabola


def _covariance(r: FloatArray, power: float, reach: float) -> tuple[FloatArray, float]:
    """Stein's covariance, twice differentiable where it joins its tail, and the coefficient of its parabola."""
    tail = 0.0 if reach == 1.0 else power * (2 - power) / (3 * reach * (reach**2 - 1))
    parabola = (power - tail * (reach - 1) ** 2 * (reach + 2)) / 2
    constant = tail * (reach - 1) ** 3 + 1 - parabola
    inner = constant - r**power + parabola * r**2
    outer = tail * np.maximum(reach - r, 0.0) ** 3 / np.maximum(r, 1.0)
    return np.where(r <= 1.0, inner, outer), parabola


def _field(spectrum: FloatArray, side: int, rng: np.random.Generator) -> FloatArray:
    from scipy import fft

    half = len(spectrum) - 1
    # Amplitudes are symmetric: wave numbers 0 to half, then half - 1 down to 1.
    mirrored = np.concatenate([np.arange(half + 1), np.arange(half - 1, 0, -1)])
    waves = np.empty((half + 1, side), dtype=np.complex128)
    for first in range(0, half + 1, _ROWS_AT_ONCE):
        amplitude = np.sqrt(spectrum[first : first + _ROWS_AT_ONCE, mirrored])
        noise = rng.standard_normal((2, *amplitude.shape))
        block = fft.fft((noise[0] + 1j * noise[1]) * amplitude, axis=1, overwrite_x=True)
        waves[first : first + _ROWS_AT_ONCE] = block[:, :side] / math.sqrt(2)
    # The two wave numbers that are their own mirror images have real coefficients.
    for own in (0, half):
        waves[own] = waves[own].real * math.sqrt(2)
    height = np.empty((side, side))
    for first in range(0, side, _ROWS_AT_ONCE):
        block = fft.irfft(waves[:, first : first + _ROWS_AT_ONCE].T, n=2 * half, axis=1)
        height[first : first + _ROWS_AT_ONCE] = block[:, :side]
    return height


def doubling_lags(side: int, largest_share: float) -> IntArray:
    """Lags of 1, 2, 4, ... samples, up to a fraction of the side."""
    return 2 ** np.arange(1 + max(1, int(math.log2(side * largest_share))))


def structure_function(height_m: FloatArray, lags: IntArray) -> FloatArray:
    """Mean square difference (lags,) of heights at given lags in samples, over both directions of the grid."""
    return np.array([_mean_square(height_m, (-1, 1), int(lag)) for lag in lags])


def second_structure_function(height_m: FloatArray, lags: IntArray) -> FloatArray:
    """Mean square (lags,) of h(x - lag) - 2 h(x) + h(x + lag), over both directions; insensitive to tilt."""
    return np.array([_mean_square(height_m, (1, -2, 1), int(lag)) for lag in lags])


def hurst_exponent(height_m: FloatArray) -> float:
    """H from the growth of second differences, whose mean square is proportional to lag^2H.

    First differences would suffice for a rough surface; on a smooth one they depend on a few long waves (Kent and Wood
    1997). The lags end at a sixteenth of the side; each is weighted by the number of independent differences on the
    grid.
    """
    lags = doubling_lags(min(height_m.shape), 1 / 16)
    x, y = np.log(lags), np.log(second_structure_function(height_m, lags))
    weight = 1.0 / lags.astype(np.float64) ** 2
    # Otherwise the finest lags would decide alone; every lag has errors that do not decrease with the number of
    # differences.
    weight = 1.0 / (1.0 / (weight * height_m.size) + 1e-4)
    x = x - np.average(x, weights=weight)
    return float((weight * x * y).sum() / (weight * x * x).sum() / 2)


def rms_slope(height_m: FloatArray, spacing_m: float, baseline_m: float, hurst: float) -> float:
    """Root mean square difference of height over a baseline, divided by the baseline.

    A baseline that is not a whole number of samples is replaced by the nearest one, scaled by the exponent.
    """
    lag = max(1, round(baseline_m / spacing_m))
    deviation_m = math.sqrt(_mean_square(height_m, (-1, 1), lag))
    return float(deviation_m * (baseline_m / (lag * spacing_m)) ** hurst / baseline_m)


def _mean_square(height_m: FloatArray, weights: tuple[int, ...], lag: int) -> float:
    """Mean square of weighted differences over `lag` samples, along rows and columns; NaN if there are none."""
    squares, count = 0.0, 0
    for grid in (height_m, height_m.T):
        length = len(grid) - lag * (len(weights) - 1)
        difference = sum(w * grid[k * lag : k * lag + length] for k, w in enumerate(weights))
        missing = np.isnan(difference)
        squares += float(np.square(np.where(missing, 0.0, difference) if missing.any() else difference).sum())
        count += length * grid.shape[1] - int(missing.sum())
    return squares / count if count else math.nan


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


Elevation = npt.NDArray[np.float32]


def elevation_m(ground: Generated) -> Elevation:
    """Elevations (rows from north to south, columns from west to east) of a ground, read from the cache or generated
    and cached.

    Processes may generate the same ground concurrently: their results are equal, and files are written atomically.
    """
    path = cache_path(ground)
    cached = None if path is None else _read(path, ground.cells + 1)
    if cached is not None:
        return cached

    made = generate(ground).elevation_m(ground)
    store(ground, made)
    return made


def store(ground: Generated, elevation: Elevation) -> Path | None:
    """Write a generated ground to the cache; returns its path, or None if the cache is not writable."""
    path = cache_path(ground)
    if path is None:
        return None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as file:
            np.savez(file, elevation_m=elevation)  # an archive has a checksum
    except (OSError, InputError, RunError):  # Such as a full disk: the run goes on with the arrays in memory.
        return None
    return path


def cache_path(ground: Generated) -> Path | None:
    """Path of a cached ground, named by a hash of everything it depends on; None for a user without a home folder."""
    asked = ground.model_dump_json(exclude={"at_m", "beyond", "detail", "interpolation"})
    digest = hashlib.sha256(f"{asked} numpy {version('numpy')} scipy {version('scipy')}".encode())
    for source in (*sorted(Path(__file__).parent.glob("*.py")), Path(generated_ground.__file__)):
        digest.update(source.read_bytes())
    try:
        return cache_folder() / "ground" / f"{digest.hexdigest()[:20]}.npz"
    except RuntimeError:
        return None


def _read(path: Path, side: int) -> Elevation | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            cached = np.asarray(archive["elevation_m"])
    except (OSError, ValueError, LookupError, EOFError, BadZipFile, NotImplementedError, RuntimeError):
        return None
    except (SyntaxError, TokenError):  # of a damaged header, which numpy parses as Python
        return None
    return cached if cached.shape == (side, side) and cached.dtype == np.float32 else None

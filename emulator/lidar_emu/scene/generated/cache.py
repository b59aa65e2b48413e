"""Cache of generated ground in the user's cache folder."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidar_emu.errors import InputError, RunError
from lidar_emu.files import cache_folder, whole_file
from lidar_emu.scenario import generated_ground
from lidar_emu.scenario.generated_ground import Generated

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
    from lidar_emu.scene.generated.generate import generate

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
            np.save(file, elevation)
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
        return cache_folder() / "ground" / f"{digest.hexdigest()[:20]}.npy"
    except RuntimeError:
        return None


def _read(path: Path, side: int) -> Elevation | None:
    try:
        with path.open("rb") as file:
            cached = np.lib.format.read_array(file, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return cached if cached.shape == (side, side) and cached.dtype == np.float32 else None

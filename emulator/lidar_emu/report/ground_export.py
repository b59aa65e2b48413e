"""Generated ground as a file that this tool and others read: .npz, GeoTIFF, ESRI ASCII grid."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidar_emu.errors import InputError
from lidar_emu.files import check_destination, check_extra, whole_file
from lidar_emu.scenario.generated_ground import Generated

Elevation = npt.NDArray[np.float32]


def check_ground_path(path: Path) -> None:
    """Raise what `export_ground` would raise for this path, before the ground is made.

    Raises:
        InputError: another suffix, a missing or read-only folder, or the extra `geo` is absent.
    """
    if path.suffix not in _WRITERS:
        raise InputError(str(path), None, path.suffix or "no suffix", f"allowed: {', '.join(_WRITERS)}")
    if path.suffix == ".tif":
        check_extra(path, "rasterio", "geo")
    check_destination(path)


def export_ground(ground: Generated, elevation_m: Elevation, path: Path) -> None:
    """Write elevations (rows from north to south, columns from west to east) of a ground around the map's origin.

    Raises:
        InputError: as `check_ground_path`.
        RunError: writing failed on the way.
    """
    check_ground_path(path)
    content = _WRITERS[path.suffix](ground, elevation_m)
    with whole_file(path) as file:
        file.write(content)


def _npz(ground: Generated, elevation_m: Elevation) -> bytes:
    content = io.BytesIO()
    np.savez_compressed(
        content,
        elevation_m=elevation_m,
        pixel_m=np.float64(ground.spacing_m),
        map_x_m=np.float64(-ground.size_m / 2),
        map_y_m=np.float64(ground.size_m / 2),
    )
    return content.getvalue()


def _tif(ground: Generated, elevation_m: Elevation) -> bytes:
    from rasterio import Affine
    from rasterio.io import MemoryFile

    # A sample stands for the centre of its pixel; a GeoTIFF says where the first one's corner is.
    corner_m = (ground.size_m + ground.spacing_m) / 2
    side = len(elevation_m)
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=side,
            height=side,
            count=1,
            dtype="float32",
            compress="deflate",
            predictor=3,
            # In metres around the origin of the site frame; that map is on no body, and has no projection to state.
            transform=Affine(ground.spacing_m, 0.0, -corner_m, 0.0, -ground.spacing_m, corner_m),
        ) as file:
            file.write(elevation_m, 1)
            file.set_band_description(1, "elevation")
        return bytes(memory.read())


def _asc(ground: Generated, elevation_m: Elevation) -> bytes:
    side = len(elevation_m)
    first_m = -ground.size_m / 2
    head = f"ncols {side}\nnrows {side}\nxllcenter {first_m!r}\nyllcenter {first_m!r}\ncellsize {ground.spacing_m!r}\n"
    rows = (" ".join(map("%.9g".__mod__, row)) for row in elevation_m.tolist())
    return (head + "\n".join(rows) + "\n").encode()


_WRITERS: dict[str, Callable[[Generated, Elevation], bytes]] = {".npz": _npz, ".tif": _tif, ".asc": _asc}

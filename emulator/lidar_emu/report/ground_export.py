"""Export of generated ground: `.npz`, GeoTIFF or ESRI ASCII grid, all readable as a scenario's grid."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidar_emu.files import check_destination, check_extra, check_suffix, whole_file
from lidar_emu.scenario.generated_ground import Generated

Elevation = npt.NDArray[np.float32]


def check_ground_path(path: Path) -> None:
    """Check the path of an export before the ground is generated.

    Raises:
        InputError: the suffix is unknown, the folder is missing or read-only, or `.tif` lacks the extra `geo`.
    """
    check_suffix(path, _WRITERS)
    if path.suffix == ".tif":
        check_extra(str(path), path.suffix, "rasterio", "geo")
    check_destination(path)


def export_ground(ground: Generated, elevation_m: Elevation, path: Path) -> None:
    """Write the elevations of a ground centred on the map's origin; rows run north to south, columns west to east.

    Raises:
        InputError: see `check_ground_path`.
        RunError: writing failed.
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

    # Samples are at pixel centres; a GeoTIFF states the corner of the first pixel.
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
            # Metres from the origin of the site frame; the map is not on a body, so it has no projection.
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

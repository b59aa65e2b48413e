"""Scenarios that are well-formed, and whose elevation grid or table of a flight cannot be used."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bad_case import FLIGHT, Case, Content, changed

ROWS = "t,z\n0,200\n1,190\n2,180\n"
_TABLE = (
    "trajectory: {kind: table, file: flight.csv, time: {column: t, unit: s}, up: {column: z, unit: m%s}%s}\n"
)


def on_grid(file: str, more: str = "") -> str:
    """The flight over an elevation grid."""
    return changed(FLIGHT, "{kind: plane, slope_deg: 1}", f"{{kind: grid, file: {file}{more}}}")


def on_table(up: str = "", more: str = "") -> str:
    """The flight of a table."""
    return FLIGHT[: FLIGHT.index("trajectory:")].replace("duration_s: 5\n", "") + _TABLE % (up, more)


def npz(**arrays: object) -> Callable[[Path], None]:
    """Writes a grid in numpy's container."""
    return lambda path: np.savez(path, **arrays)  # type: ignore[arg-type]


def _nowhere_tif(path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="GeoTIFF needs the extra geo")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        shape = {"width": 8, "height": 8, "count": 1, "dtype": "float32"}
        with rasterio.open(path, "w", driver="GTiff", **shape) as file:
            file.write(np.zeros((1, 8, 8), dtype=np.float32))


LEVEL = npz(elevation_m=np.zeros((20, 20)), pixel_m=10.0, map_x_m=0.0, map_y_m=190.0)
_HOLLOW = npz(elevation_m=np.full((4, 4), np.nan), pixel_m=1.0)
_MARKED = npz(elevation_m=np.full((4, 4), -9999.0), pixel_m=1.0)
_NO_PIXEL = npz(elevation_m=np.zeros((4, 4)))
_OFF = ", origin: {map_x_m: 500, map_y_m: 50}"
_TWO = ", origin: {latitude_deg: 3, longitude_deg: 3, map_x_m: 1, map_y_m: 1}"

_GRIDS: list[tuple[str, str, Content | None, str, tuple[str, ...]]] = [
    ("no grid", "dem.npz", None, "", ("dem.npz", "no such file", "use a GeoTIFF")),
    ("a grid's name too long", 300 * "x", None, "", ("my.yaml: site.ground.file: File name too long: 'xxx",)),
    ("empty npz", "dem.npz", b"", "", ("dem.npz", "unreadable", "use an intact")),
    ("empty GeoTIFF", "dem.tif", b"", "", ("dem.tif", "unreadable", "use an intact")),
    ("npz without keys", "dem.npz", npz(), "", ("dem.npz: elevation_m", "store elevation_m")),
    ("npz without pixel", "dem.npz", _NO_PIXEL, "", ("dem.npz: pixel_m", "or state ground.pixel_m")),
    ("GeoTIFF from nowhere", "dem.tif", _nowhere_tif, "", ("dem.tif", "no georeference", "world file", "dem.tfw")),
    ("all samples NaN", "dem.npz", _HOLLOW, "", ("dem.npz", "every sample is missing", "use a grid with elev")),
    ("all samples nodata", "dem.npz", _MARKED, ", nodata: -9999", ("dem.npz", "every sample is missing")),
    ("origin off the grid", "dem.npz", LEVEL, _OFF, ("dem.npz: ground.origin", "x 500 m", "x from 0 to 190 m")),
    ("half an origin", "dem.npz", LEVEL, ", origin: {latitude_deg: 3}", ("longitude_deg: missing", "or neither")),
    ("two origins", "dem.npz", LEVEL, _TWO, ("my.yaml: site.ground.origin.map_x_m: must be left out", "not both")),
    ("band 1.5", "dem.npz", LEVEL, ", band: 1.5",
     ("my.yaml: site.ground.band: must be text", "or a whole number", "(got 1.5)")),
]  # fmt: skip

_TABLES: list[tuple[str, str | None, str, tuple[str, ...]]] = [
    ("no table", None, on_table(), ("flight.csv", "no such file", "use a readable CSV file")),
    ("empty table", "", on_table(), ("flight.csv", "an empty file", "a header")),
    ("no such column", "t,up\n0,1\n1,2\n", on_table(), ("flight.csv: column: must be a name", "t, up", "(got 'z')")),
    ("text in a column", ROWS.replace("190", "high"), on_table(), ("flight.csv: line 3, z: must be", "'high'")),
    ("time out of order", ROWS.replace("2,", "0.5,"), on_table(), ("flight.csv: line 4, t: must be above 1", "0.5")),
    ("gap", ROWS.replace("2,", "50,"), on_table(), ("flight.csv: z", "no value for 49 s", "maximum_gap_s above 10")),
    ("half a rate", ROWS, on_table(", rate_column: v"), ("trajectory.up.rate_unit: missing", "rate_column")),
    ("two attitudes", ROWS, on_table("", ", roll: {column: z, unit: deg}, quaternion: {columns: [z, z, z, z]}"),
     ("my.yaml: trajectory.quaternion", "roll, pitch and yaw, not both")),
]  # fmt: skip

_MAP: dict[str, Content] = {"my.yaml": on_grid("dem.npz"), "dem.npz": LEVEL}
_PICTURE: dict[str, Content] = {"my.yaml": on_grid("dem.png", ", pixel_m: 10"), "dem.png": b"any"}
_OVER_INPUTS: list[tuple[dict[str, Content], str, str, str]] = [
    ({"my.yaml": on_table(), "fl.csv": ROWS}, "simulate my.yaml --set trajectory.file=fl.csv --out fl.csv",
     "--out", "fl.csv"),
    (_MAP, "simulate my.yaml --geometry-out ./dem.npz", "--geometry-out", "dem.npz"),
    (_PICTURE, "simulate my.yaml --plot a.png --plot dem.png", "--plot", "dem.png"),
    (_MAP, "hazards my.yaml --map dem.npz", "--map", "dem.npz"),
    (_PICTURE, "hazards my.yaml --plot dem.png", "--plot", "dem.png"),
    (_MAP, "ground my.yaml --out dem.npz", "--out", "dem.npz"),
    (_PICTURE, "ground my.yaml --statistics dem.png", "--statistics", "dem.png"),
    ({"my.yaml": FLIGHT, "g.npz": b"any"}, "simulate my.yaml --geometry g.npz --out g.npz", "--out", "g.npz"),
]  # fmt: skip


def _files(text: str, name: str, content: Content | None) -> dict[str, Content]:
    return {"my.yaml": text} if content is None else {"my.yaml": text, name: content}


CASES = [
    *(
        Case(name, expected, _files(on_grid(file, more), file, grid))
        for name, file, grid, more, expected in _GRIDS
    ),
    *(Case(name, expected, _files(text, "flight.csv", rows)) for name, rows, text, expected in _TABLES),
    Case(
        "flight off the grid",
        ("trajectory", "m east", "stay over the ground", "beyond: plane or sphere"),
        _files(
            changed(on_grid("dem.npz"), "kind: profile", "kind: profile\n  path_angle_deg: 10"),
            "dem.npz",
            LEVEL,
        ),
    ),
    *(
        Case(command, (f"{option}: must be another file than the one that is read", file), files, command)
        for files, command, option, file in _OVER_INPUTS
    ),
]

"""Raster files through rasterio: GeoTIFF, PDS images by their labels, ESRI ASCII and any other format that it reads."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import MOST_BYTES_IN_MEMORY, check_extra, check_file
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.model import Ellipsoid, check_heights, numbers

_INTACT = "use an intact ESRI ASCII grid"
_IN_NUMBERS = np.zeros(256, dtype=bool)
_IN_NUMBERS[np.frombuffer(b"0123456789+-.,eEnNaAiIfF \t\r\n", dtype=np.uint8)] = True

_NO_NUMBER = re.compile(rb"[.,]\S*[.,]|[0-9.,][+-]|[+-](?![0-9.,nNiI])")
"""What GDAL reads the first number of."""


def check_ascii_grid(path: str, rows: int, columns: int) -> None:
    """Refuse a grid with other than `rows` times `columns` numbers below its header."""
    check_file(Path(path), _INTACT, MOST_BYTES_IN_MEMORY)
    below = _below_header(Path(path).read_bytes())
    content = np.frombuffer(below, dtype=np.uint8)
    other = np.flatnonzero(~_IN_NUMBERS[content])
    if (strange := _NO_NUMBER.search(below)) is not None:
        other = np.append(other, strange.start())
    if other.size:
        word = below[max(0, other[0] - 10) : other[0] + 10].split()
        text = " ".join(each.decode("ascii", "replace") for each in word)
        raise InputError(path, None, Finding(f"not a number, near {text!r}"), _INTACT)
    blank = np.concatenate([[True], content <= ord(" ")])
    count = int((blank[:-1] & ~blank[1:]).sum())
    if count != rows * columns:
        found = f"{count} numbers for {rows} rows of {columns}"
        raise InputError(path, None, Finding(found), _INTACT)


def _below_header(content: bytes) -> bytes:
    while (line := content.partition(b"\n"))[0].lstrip()[:1].isalpha():
        # A missing sample rather than a key.
        if line[0].split()[0].lower() in (b"nan", b"inf"):
            break
        content = line[2]
    return content


_UNITS = {
    1.0: "m metre metres meter meters",
    1000.0: "km kilometre kilometres kilometer kilometers",
    0.1: "dm decimetre decimetres decimeter decimeters",
    0.01: "cm centimetre centimetres centimeter centimeters",
    0.001: "mm millimetre millimetres millimeter millimeters",
    0.3048: "ft foot feet international_foot ift",
    1200 / 3937: "us_survey_foot us_survey_feet us_ft ftus sft foot_us",
}
_METRES_PER_UNIT = {name: metres for metres, names in _UNITS.items() for name in names.split()}
_UNSTATED = ("", "unspecified", "unknown", "none", "n/a")
# Formats of files that hold their own samples: a virtual raster reads any file, and asks servers.
_DRIVERS = [
    "GTiff", "PDS", "PDS4", "ISIS2", "ISIS3", "VICAR", "AAIGrid", "GRASSASCIIGrid", "SRTMHGT", "ENVI", "EHdr", "ERS",
    "USGSDEM", "DTED", "HFA", "netCDF", "HDF4", "HDF5", "JP2OpenJPEG", "XYZ", "GSAG", "GSBG", "GS7BG", "SAGA", "RST",
    "PNG",
]  # fmt: skip
# The labels of the MOLA grids count from one pixel further out than the standard and all other labels; GDAL's page on
# PDS names this setting for them. Without it the map lies a pixel to the north-west: up to 15 km.
_MOLA = {"PDS_SampleProjOffset_Shift": "-0.5", "PDS_LineProjOffset_Shift": "-0.5"}

SAMPLE_IN_PIXEL = 0.5
"""Position of a sample within its pixel, in pixels from the corner that rasterio's transform gives: for files whose
samples are points (GeoTIFF PixelIsPoint, ESRI xllcenter) it has already shifted the transform by half a pixel."""


@contextmanager
def open_raster(path: str) -> Iterator[Any]:
    """Open a raster file as a `rasterio.DatasetReader`."""
    check_extra(path, "an elevation file other than .npz", "rasterio", "geo")
    import rasterio

    try:
        with warnings.catch_warnings():
            # A file without a position on a map is refused elsewhere, with the project's own message.
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.Env(**_settings(rasterio, path)), _opened(path) as file:
                if file.driver == "AAIGrid":
                    check_ascii_grid(path, file.height, file.width)
                yield file
    except failures() as error:
        raise InputError(path, None, Finding(f"unreadable, {_cause(error)}"), _remedy(path)) from None


def _opened(path: str) -> Any:
    # `rasterio.open` takes one driver alone.
    from rasterio.io import DatasetReader

    return DatasetReader(path, driver=_DRIVERS)


def failures() -> tuple[type[Exception], ...]:
    """Exception types of rasterio, and of GDAL where they pass through it: their base class has no public name."""
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import CRSError, RasterioError

    return RasterioError, CRSError, CPLE_BaseError


def band_number(path: str, file: Any, key: str, band: str | int) -> int:
    """Number of the band that a key of the ground names."""
    if isinstance(band, int):
        matches = [band] if band <= file.count else []
    else:
        names = [(name or "").lower() for name in file.descriptions]
        matches = [number for number, name in enumerate(names, start=1) if name == band.lower()]
        if not matches and key == "band" and file.count == 1 and (band == "elevation" or not names[0]):
            matches = [1]
    if len(matches) == 1:
        return matches[0]
    expected = [*(repr(name) for name in file.descriptions if name), f"or a number from 1 to {file.count}"]
    meant = "the band of elevations: " if key == "band" else ""
    raise InputError(path, f"ground.{key}", band, f"must be {meant}{', '.join(expected)}")


def elevations_m(ground: ElevationGrid, file: Any, band: int, window: Any = None) -> FloatArray:
    """Read elevations (rows, columns) in metres above the site's datum, NaN where missing.

    Args:
        ground: the scenario's keys of the file.
        file: the open file.
        band: number of the band.
        window: a `rasterio.windows.Window`; None: the whole band.
    """
    stored, values = _read_band(ground, file, band, window)
    scale = ground.elevation_scale or _metres_per_unit(ground.file, file, band)
    elevation_m = values * scale + ground.elevation_offset_m
    check_heights(ground.file, stored, elevation_m, ground.nodata)
    return elevation_m


def other_bands(ground: ElevationGrid, file: Any) -> dict[str, int]:
    """Numbers of the other bands that the site names, by their names in a `Terrain`."""
    asked = {"reflectance": ground.reflectance_band, "rock_abundance": ground.rock_abundance_band}
    return {
        name: band_number(ground.file, file, f"{name}_band", band)
        for name, band in asked.items()
        if band is not None
    }


def shares(ground: ElevationGrid, file: Any, name: str, number: int, window: Any = None) -> FloatArray:
    """Values (rows, columns) of one of the other bands, NaN where missing; see `elevations_m`."""
    _, values = _read_band(ground, file, number, window)
    outside = values[(values < 0) | (values > 1)]
    if outside.size:
        raise InputError(
            ground.file, f"ground.{name}_band", float(outside[0]), "must hold numbers from 0 to 1"
        )
    return values


def _read_band(
    ground: ElevationGrid, file: Any, band: int, window: Any
) -> tuple[npt.NDArray[np.generic], FloatArray]:
    """Numbers (rows, columns) of a band as stored, and as physical values in its own unit, NaN where missing."""
    stored = file.read(band, window=window)
    if stored.dtype.kind not in "fiu":
        raise InputError(ground.file, "ground.band", str(stored.dtype), "must name a band of real numbers")
    values = numbers(stored, ground.nodata, file.read_masks(band, window=window) == 0)
    scale, offset = float(file.scales[band - 1]), float(file.offsets[band - 1])
    if not (0.0 < scale < inf and isfinite(offset)):
        found = Finding(f"scale {scale:g} and offset {offset:g} of its band")
        raise InputError(ground.file, None, found, "use a scale above 0: heights are counted upward")
    return stored, values * scale + offset


def _cause(error: BaseException) -> BaseException:
    """The first of a chain of errors: rasterio's own only refers to it."""
    while error.__cause__ is not None:
        error = error.__cause__
    return error


def _settings(rasterio: Any, path: str) -> dict[str, str]:
    with rasterio.Env(), _opened(path) as file:
        return _MOLA if file.driver == "PDS" and "MOLA" in file.tags().get("DATA_SET_ID", "") else {}


def _remedy(path: str) -> str:
    label = Path(path).with_suffix(".lbl")
    if Path(path).suffix.lower() == ".img":
        return f"name the label of the PDS image, such as {label.name}"
    return "use an intact GeoTIFF, PDS label or ESRI ASCII grid"


def _metres_per_unit(path: str, file: Any, band: int) -> float:
    unit = file.units[band - 1] or _unit_of_label(file)
    if unit.strip().lower() in _UNSTATED:
        return _metres_of_vertical_axis(file)
    metres = _METRES_PER_UNIT.get(re.sub(r"[\s\-.]+", "_", unit.strip().lower()).strip("_"))
    if metres is None:
        remedy = "state ground.elevation_scale, the metres of one"
        raise InputError(path, None, Finding(f"heights in {unit.strip()!r}"), remedy)
    return metres


def _metres_of_vertical_axis(file: Any) -> float:
    """Metres in the unit of the file's vertical coordinate system; 1 without one."""
    if not file.crs:
        return 1.0
    definition = file.crs.to_dict(projjson=True)
    definition = definition.get("source_crs", definition)
    for system in definition.get("components", [definition]):
        for axis in system.get("coordinate_system", {}).get("axis", ()):
            if axis.get("direction") == "up":
                unit = axis.get("unit", "metre")
                return float(unit["conversion_factor"]) if isinstance(unit, dict) else 1.0
    return 1.0


def _unit_of_label(file: Any) -> str:
    # rasterio takes the label, JSON text, for a key and a value, and splits it at its first equals sign or colon.
    text = ":".join(part for pair in file.tags(ns="json:PDS").items() for part in pair)
    image = json.loads(text).get("IMAGE", {}) if text else {}
    return str(image.get("UNIT", ""))


_DEGREES = np.arange(-180.0, 180.0)


@dataclass(frozen=True)
class Projection:
    """The map of a file, on the body that the file states, by PROJ through rasterio.

    Latitudes here are planetographic; the convention of the file is converted.
    """

    wkt: str
    """Projection as the file states it, WKT."""

    def map_xy(self, latitude_rad: FloatArray, longitude_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Map coordinates of points (n,) in the map's unit; NaN where a point is off the map."""
        latitude = np.asarray(latitude_rad)
        if self._is_planetocentric:
            square = (self.ellipsoid.polar_m / self.ellipsoid.equatorial_m) ** 2
            latitude = np.arctan2(square * np.sin(latitude), np.cos(latitude))
        turns = np.degrees(np.asarray(longitude_rad)) + 180.0
        return _transform(self._body, self._map, turns % 360.0 - 180.0, np.degrees(latitude))

    def geodetic(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Latitude and east longitude of points (n,) on the map; NaN off the body."""
        longitude_deg, latitude_deg = _transform(self._map, self._body, np.asarray(x), np.asarray(y))
        latitude_deg[~(np.abs(latitude_deg) <= 90.0)] = np.nan
        latitude = np.radians(latitude_deg)
        if self._is_planetocentric:
            latitude = self.normal_angle(latitude)
        return latitude, np.radians(longitude_deg)

    def normal_angle(self, planetocentric_rad: FloatArray) -> FloatArray:
        """Planetographic from planetocentric latitude: its tangent is larger by (a/b)²."""
        square = (self.ellipsoid.equatorial_m / self.ellipsoid.polar_m) ** 2
        return np.asarray(np.arctan2(square * np.sin(planetocentric_rad), np.cos(planetocentric_rad)))

    @cached_property
    def ellipsoid(self) -> Ellipsoid:
        stated = (self._base.get("datum") or self._base["datum_ensemble"])["ellipsoid"]
        equatorial_m = float(stated.get("radius") or stated["semi_major_axis"])
        polar_m = float(stated.get("semi_minor_axis", equatorial_m))
        if stated.get("inverse_flattening"):
            polar_m = equatorial_m * (1 - 1 / float(stated["inverse_flattening"]))
        return Ellipsoid(equatorial_m, polar_m)

    @cached_property
    def turn(self) -> float | None:
        """Length of a full turn of longitude in the map's unit, if meridians are straight and evenly spaced."""
        along, _ = self.map_xy(np.zeros(360), np.radians(_DEGREES))
        higher, _ = self.map_xy(np.full(360, 0.5), np.radians(_DEGREES))
        step = np.diff(along)
        degree = float(np.median(step))
        # The map is cut along one meridian.
        even = np.abs(step - degree) <= 1e-6 * abs(degree)
        if not (
            degree > 0 and even.sum() >= len(step) - 1 and np.allclose(along, higher, rtol=0, atol=degree)
        ):
            return None
        return 360.0 * degree

    @cached_property
    def _map(self) -> Any:
        from rasterio.crs import CRS

        return CRS.from_wkt(self.wkt)

    @cached_property
    def _body(self) -> Any:
        from rasterio.crs import CRS

        axes = f"+a={self.ellipsoid.equatorial_m!r} +b={self.ellipsoid.polar_m!r}"
        return CRS.from_proj4(f"+proj=longlat {axes} +no_defs")

    @cached_property
    def _base(self) -> dict[str, Any]:
        definition = self._map.to_dict(projjson=True)
        # The system is compound where the file also states a vertical system or a datum shift.
        definition = definition.get("source_crs", definition)
        definition = definition.get("components", [definition])[0]
        base: dict[str, Any] = definition.get("base_crs", definition)
        return base

    @cached_property
    def _is_planetocentric(self) -> bool:
        # The IAU's list of coordinate systems calls them "Ocentric".
        return self.ellipsoid.square_eccentricity != 0 and "ocentric" in self._base["name"].lower()


def _transform(source: Any, target: Any, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    from rasterio.warp import transform

    try:
        there = transform(source, target, x, y)
    except failures():
        # A single point without an image makes the whole call fail: halve until it is alone.
        if len(x) == 1:
            return np.array([np.nan]), np.array([np.nan])
        middle = len(x) // 2
        parts = (_transform(source, target, x[k], y[k]) for k in (slice(middle), slice(middle, None)))
        first, second = parts
        return np.concatenate([first[0], second[0]]), np.concatenate([first[1], second[1]])
    there_x, there_y = (np.array(values, dtype=np.float64) for values in there)
    lost = ~(np.isfinite(there_x) & np.isfinite(there_y))
    there_x[lost] = there_y[lost] = np.nan
    return there_x, there_y

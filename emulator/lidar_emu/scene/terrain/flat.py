"""Flat grids, whose map plane is the horizontal plane of the site."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.model import Terrain, check_size, refuse_nothing

ON_GROUND = "choose a point on the ground"
_METRES = "with ground.placement flat, reproject it to metres (gdalwarp -t_srs)"


@dataclass(frozen=True)
class FlatMap:
    """Elevations on a map in metres, north up."""

    elevation_m: FloatArray
    """(rows, columns) Elevation above the datum, rows from north to south; NaN where missing."""
    first_x_m: float
    """Map easting of the first column."""
    first_y_m: float
    """Map northing of the first row."""
    pixel_x_m: float
    """Distance between columns."""
    pixel_y_m: float
    """Distance between rows."""
    source: str
    """The file."""
    has_map: bool = True
    """Whether the file states its position on a map."""
    projection: str | None = None
    """The map's projection as WKT, where the file states one."""
    reflectance: FloatArray | None = None
    """(rows, columns) albedo."""
    rock_abundance: FloatArray | None = None
    """(rows, columns) Fraction of the area covered by rocks."""
    made_of: str = ""
    """What the samples were made of, for plans; empty if the file holds them."""

    @property
    def last_x_m(self) -> float:
        """Map easting of the last column."""
        return float(self.first_x_m + self.pixel_x_m * (self.elevation_m.shape[1] - 1))

    @property
    def last_y_m(self) -> float:
        """Map northing of the last row."""
        return float(self.first_y_m - self.pixel_y_m * (self.elevation_m.shape[0] - 1))


def read_flat_raster(ground: ElevationGrid, file: Any) -> FlatMap:
    """Read the bands of an open raster file on its map."""
    from lidar_emu.scene.terrain.raster import SAMPLE_IN_PIXEL, band_number, elevations_m, other_bands, shares

    check_size(ground.file, file.height, file.width)
    has_map = not file.transform.is_identity
    if has_map:
        refuse_pixel(ground)
        _check_map(ground.file, file)
        transform, place = file.transform, SAMPLE_IN_PIXEL
    else:
        if ground.pixel_m is None:
            refuse_no_place(ground.file)
        from rasterio import Affine

        transform, place = Affine.scale(ground.pixel_m, -ground.pixel_m), 0.0
    others = {name: shares(ground, file, name, number) for name, number in other_bands(ground, file).items()}
    return FlatMap(
        elevation_m=elevations_m(ground, file, band_number(ground.file, file, "band", ground.band)),
        first_x_m=transform.c + place * transform.a,
        first_y_m=transform.f + place * transform.e,
        pixel_x_m=transform.a,
        pixel_y_m=-transform.e,
        source=ground.file,
        has_map=has_map,
        projection=file.crs.to_wkt() if file.crs else None,
        reflectance=others.get("reflectance"),
        rock_abundance=others.get("rock_abundance"),
    )


def placed_flat(flat: FlatMap, ground: ElevationGrid) -> Terrain:
    """Place a map's plane as the site's horizontal plane, with the map's north as the site's."""
    refuse_nothing(flat.source, flat.elevation_m)
    x_m, y_m = _origin(flat, ground)
    place = f"map x {x_m:.9g} m, y {y_m:.9g} m"
    if not (flat.first_x_m <= x_m <= flat.last_x_m and flat.last_y_m <= y_m <= flat.first_y_m):
        area = (
            f"x from {flat.first_x_m:.9g} to {flat.last_x_m:.9g} m, "
            f"y from {flat.last_y_m:.9g} to {flat.first_y_m:.9g} m"
        )
        raise InputError(flat.source, "ground.origin", Finding(f"{place}, off the grid"), f"use {area}")
    elevation_m = _bilinear(flat, x_m, y_m)
    if np.isnan(elevation_m):
        raise InputError(
            flat.source, "ground.origin", Finding(f"{place}, where samples are missing"), ON_GROUND
        )
    return Terrain(
        elevation_m=flat.elevation_m,
        west_m=flat.first_x_m - x_m,
        north_m=flat.first_y_m - y_m,
        pixel_east_m=flat.pixel_x_m,
        pixel_north_m=flat.pixel_y_m,
        origin_elevation_m=elevation_m,
        source=flat.source,
        reflectance=flat.reflectance,
        rock_abundance=flat.rock_abundance,
        placed=flat.made_of,
    )


def refuse_no_place(where: str) -> NoReturn:
    """Refuse a raster file without georeference, with the ways to give it one."""
    path = Path(where)
    world = path.with_suffix(f"{path.suffix[:2]}{path.suffix[-1:]}w").name
    remedy = f"add a world file {world}, or state ground.pixel_m, the distance between samples in metres"
    raise InputError(where, None, Finding("no georeference"), remedy)


def refuse_pixel(ground: ElevationGrid) -> None:
    """Refuse a `pixel_m` for a file that states its own."""
    if ground.pixel_m is not None:
        raise InputError(ground.file, "ground.pixel_m", ground.pixel_m, "leave it out: the file states it")


def refuse_bands(ground: ElevationGrid) -> None:
    """Refuse keys about bands and pixels, for a file of elevations alone."""
    kind = Path(ground.file).suffix
    if ground.band not in ("elevation", "elevation_m", 1):
        remedy = f"must be elevation, all that a {kind} file holds"
        raise InputError(ground.file, "ground.band", ground.band, remedy)
    for key in ("reflectance_band", "rock_abundance_band"):
        if getattr(ground, key) is not None:
            remedy = f"leave it out: a {kind} file holds elevations only"
            raise InputError(ground.file, f"ground.{key}", getattr(ground, key), remedy)


def _check_map(where: str, file: Any) -> None:
    """Refuse a file that is not a map in metres with north up; ASCII grids that state no projection are accepted."""
    transform = file.transform
    if transform.b or transform.d or transform.a <= 0 or transform.e >= 0:
        remedy = "store rows from north to south and columns from west to east"
        raise InputError(where, None, Finding("a rotated or mirrored grid"), remedy)
    if not file.crs:
        return
    if not file.crs.is_projected:
        raise InputError(where, None, Finding("a grid on no projected map, such as one in degrees"), _METRES)
    unit, metres = file.crs.linear_units_factor
    if not np.isclose(metres, 1.0, rtol=1e-12):
        raise InputError(where, None, Finding(f"a map in {unit}"), _METRES)


def _origin(flat: FlatMap, ground: ElevationGrid) -> tuple[float, float]:
    origin = ground.origin
    centre = "leave the origin out for the grid's centre"
    if origin.latitude_deg is not None and origin.longitude_deg is not None:
        if flat.projection is None:
            remedy = f"the file states no projection: use map_x_m and map_y_m, or {centre}"
            raise InputError(flat.source, "ground.origin.latitude_deg", origin.latitude_deg, remedy)
        return _on_map(flat.source, flat.projection, origin.latitude_deg, origin.longitude_deg)
    if origin.map_x_m is not None and origin.map_y_m is not None:
        if not flat.has_map:
            remedy = f"the file states no map coordinates: {centre}"
            raise InputError(flat.source, "ground.origin.map_x_m", origin.map_x_m, remedy)
        return origin.map_x_m, origin.map_y_m
    return (flat.first_x_m + flat.last_x_m) / 2, (flat.first_y_m + flat.last_y_m) / 2


def _on_map(source: str, wkt: str, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    from lidar_emu.scene.terrain.raster import Projection

    projection = Projection(wkt)
    latitude = projection.normal_angle(np.radians([latitude_deg]))
    (x_m,), (y_m,) = projection.map_xy(latitude, np.radians([longitude_deg]))
    if np.isnan(x_m):
        found = Finding(f"latitude {latitude_deg:g}, longitude {longitude_deg:g}, off the map")
        raise InputError(source, "ground.origin", found, "choose a point on the map of the file")
    return float(x_m), float(y_m)


def _bilinear(flat: FlatMap, x_m: float, y_m: float) -> float:
    rows, columns = flat.elevation_m.shape
    across = (x_m - flat.first_x_m) / flat.pixel_x_m
    down = (flat.first_y_m - y_m) / flat.pixel_y_m
    column, row = min(int(across), columns - 2), min(int(down), rows - 2)
    a, b = across - column, down - row
    (z00, z10), (z01, z11) = flat.elevation_m[row : row + 2, column : column + 2].tolist()
    return float((z00 * (1 - a) + z10 * a) * (1 - b) + (z01 * (1 - a) + z11 * a) * b)

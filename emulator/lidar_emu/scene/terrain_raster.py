"""Elevation grids read with rasterio: GeoTIFF, ESRI ASCII and whatever else it knows."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.site import Grid
from lidar_emu.scene.terrain import Terrain, check_size, elevations

_METRES = "allowed: a map in metres; reproject it (gdalwarp -t_srs)"


def read_raster(ground: Grid) -> Terrain:
    """One band of a raster file as elevations on a map in metres, north up.

    Raises:
        InputError: rasterio is absent, or the file is damaged or of another kind.
    """
    rasterio = _import_rasterio(ground.file)
    try:
        with warnings.catch_warnings():
            # A file without a place on a map is refused below, in the project's own words.
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(ground.file) as file:
                return _read(ground, file)
    except _failures() as error:
        allowed = f"{error}; allowed: an intact GeoTIFF or ESRI ASCII grid"
        raise InputError(ground.file, None, Finding("unreadable"), allowed) from None


def project(terrain: Terrain, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Map easting and northing, in metres, of a planetocentric latitude and an east longitude.

    Raises:
        InputError: the point has no place on the map.
    """
    rasterio = _import_rasterio(terrain.source)
    from rasterio.warp import transform

    projection = rasterio.crs.CRS.from_wkt(terrain.projection)
    equatorial_m, polar_m, is_planetocentric = _ellipsoid(projection)
    body = rasterio.crs.CRS.from_proj4(f"+proj=longlat +a={equatorial_m!r} +b={polar_m!r} +no_defs")
    map_latitude_deg = latitude_deg
    if not is_planetocentric:
        # The angle of the normal instead of that of the radius: its tangent is greater by (a/b)².
        centric = math.radians(latitude_deg)
        graphic = math.atan2(math.sin(centric) * equatorial_m**2, math.cos(centric) * polar_m**2)
        map_latitude_deg = math.degrees(graphic)
    try:
        (x_m,), (y_m,) = transform(body, projection, [(longitude_deg + 180) % 360 - 180], [map_latitude_deg])
    except _failures():
        x_m = y_m = math.inf
    if not (math.isfinite(x_m) and math.isfinite(y_m)):
        found = f"latitude {latitude_deg:g}, longitude {longitude_deg:g}"
        raise InputError(terrain.source, "ground.origin", found, "allowed: a point on the map of the file")
    return x_m, y_m


def _import_rasterio(where: str) -> Any:
    try:
        import rasterio
    except ImportError:
        raise InputError(
            where,
            None,
            Finding("a file of this kind"),
            "it needs rasterio (pip install 'lidar-emu[geo]'); allowed without it: .npz",
        ) from None
    return rasterio


def _failures() -> tuple[type[Exception], ...]:
    """What rasterio raises, and GDAL's own errors that pass through it: their base has no public name."""
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import CRSError, RasterioError

    return RasterioError, CRSError, CPLE_BaseError


def _ellipsoid(projection: Any) -> tuple[float, float, bool]:
    """Semi-axes of the body, and whether the map's latitudes are planetocentric."""
    definition = projection.to_dict(projjson=True)
    # Wrapped where the file also states a vertical system or a shift to another datum.
    definition = definition.get("source_crs", definition)
    base = definition.get("components", [definition])[0]["base_crs"]
    ellipsoid = (base.get("datum") or base["datum_ensemble"])["ellipsoid"]
    equatorial_m = float(ellipsoid.get("radius") or ellipsoid["semi_major_axis"])
    polar_m = float(ellipsoid.get("semi_minor_axis", equatorial_m))
    if ellipsoid.get("inverse_flattening"):
        polar_m = equatorial_m * (1 - 1 / float(ellipsoid["inverse_flattening"]))
    # "Ocentric" is how the IAU's list of coordinate systems names those of planetocentric latitude.
    return equatorial_m, polar_m, equatorial_m == polar_m or "ocentric" in base["name"].lower()


def _read(ground: Grid, file: Any) -> Terrain:
    _check_map(ground.file, file)
    check_size(ground.file, file.height, file.width)
    band = _band(ground, file)
    stored = file.read(band)
    if stored.dtype.kind not in "fiu":
        raise InputError(ground.file, "ground.band", str(stored.dtype), "allowed: a band of real numbers")
    place = _place_in_pixel(ground, file)
    transform = file.transform
    return Terrain(
        elevation_m=elevations(
            ground, stored, file.read_masks(band) == 0, file.scales[band - 1], file.offsets[band - 1]
        ),
        first_x_m=transform.c + place * transform.a,
        first_y_m=transform.f + place * transform.e,
        pixel_x_m=transform.a,
        pixel_y_m=-transform.e,
        source=ground.file,
        projection=file.crs.to_wkt() if file.crs else None,
    )


def _check_map(where: str, file: Any) -> None:
    """Refuse what is no map in metres with north up; ASCII grids mostly state no projection and pass."""
    transform = file.transform
    if transform.is_identity:
        raise InputError(
            where, None, Finding("no georeference"), "allowed: a file that states its place on a map"
        )
    if transform.b or transform.d or transform.a <= 0 or transform.e >= 0:
        found = "a rotated or mirrored grid"
        raise InputError(where, None, found, "allowed: rows from north to south, columns from west to east")
    if not file.crs:
        return
    if not file.crs.is_projected:
        raise InputError(where, None, Finding("a grid on no projected map, such as one in degrees"), _METRES)
    unit, metres = file.crs.linear_units_factor
    if not np.isclose(metres, 1.0, rtol=1e-12):
        raise InputError(where, None, Finding(f"a map in {unit}"), _METRES)


def _band(ground: Grid, file: Any) -> int:
    """Number of the band asked for."""
    names = [(name or "").lower() for name in file.descriptions]
    allowed = ", ".join(repr(name) for name in file.descriptions if name)
    allowed = f"allowed: {allowed + ', or ' if allowed else ''}a number from 1 to {file.count}"
    if isinstance(ground.band, int):
        if ground.band > file.count:
            raise InputError(ground.file, "ground.band", ground.band, allowed)
        return ground.band
    matches = [number for number, name in enumerate(names, start=1) if name == ground.band.lower()]
    if len(matches) == 1:
        return matches[0]
    if file.count == 1 and (ground.band == "elevation" or not names[0]):
        return 1
    raise InputError(ground.file, "ground.band", ground.band, allowed)


def _place_in_pixel(ground: Grid, file: Any) -> float:
    """Where in its pixel the sample lies, in pixels from the north-west corner, by rasterio's transform.

    rasterio reports every file by the corners of its pixels: where the file says that its samples are points
    (GeoTIFF PixelIsPoint, ESRI xllcenter), the transform is already moved by half a pixel, so that the
    centre is right for both. Where the site contradicts the file, that half pixel is added or taken away.
    """
    stated = "point" if file.tags().get("AREA_OR_POINT", "Area").lower() == "point" else "area"
    if ground.registration in ("file", stated):
        return 0.5
    return 0.0 if ground.registration == "point" else 1.0

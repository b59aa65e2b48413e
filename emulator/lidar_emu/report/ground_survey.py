"""A survey of a site's ground: heights and slopes over its area, and where the beams of the flight fall."""

from __future__ import annotations

import io
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lidar_emu.beams.flight import Flight
from lidar_emu.files import check_destination, check_extra, check_suffix, whole_file
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scenario.ground import Generated
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene import build_ground, with_objects
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.mesh.ground import MeshGround
from lidar_emu.scene.mosaic.grids import PaintedGround
from lidar_emu.scene.mosaic.nested import NestedGround, extent
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.scene.ray_reach import Rectangle

MOST_SAMPLES = 1000
"""Samples of a survey along each side, at most."""
_MOST_SHOTS = 2000
_MARGIN = 0.25
"""Width of the margin around a footprint, as a fraction of its longer side."""
_UNKNOWN_M = 1000.0
"""Half the side of the area of a ground without edges, under a flight that is not known before."""


@dataclass(frozen=True)
class FlightFootprint:
    """Where the beams of a flight fall, of shots along it."""

    path_site_m: FloatArray
    """(shots, 3) Positions of the sensor."""
    point_site_m: FloatArray
    """(shots, beams, 3) First contact of the beams' axes; NaN where they hit nothing."""
    incidence_deg: FloatArray
    """(shots, beams) Angle between beam and normal of the ground; NaN where the axis hits nothing."""

    @property
    def area(self) -> Rectangle:
        """The smallest rectangle with all points; around the path if there are none."""
        hit_m = self.point_site_m[np.isfinite(self.point_site_m).all(axis=-1)]
        (west_m, south_m), (east_m, north_m) = (
            extreme(hit_m[:, :2] if len(hit_m) else self.path_site_m[:, :2], axis=0)
            for extreme in (np.min, np.max)
        )
        return Rectangle(float(west_m), float(east_m), float(south_m), float(north_m))


@dataclass(frozen=True)
class GroundSurvey:
    """Heights and slopes of the ground on a lattice."""

    description: str
    east_m: FloatArray
    """(columns,) East coordinates."""
    north_m: FloatArray
    """(rows,) North coordinates, ascending."""
    up_m: FloatArray
    """(rows, columns) Heights above the origin of the site frame; NaN where there is no ground."""
    footprint: FlightFootprint | None
    """None for a flight that is not known before, with live truth."""

    @property
    def area(self) -> Rectangle:
        return Rectangle(*self.east_m[[0, -1]].tolist(), *self.north_m[[0, -1]].tolist())

    @property
    def step_m(self) -> tuple[float, float]:
        """Distances between columns and between rows."""
        return float(self.east_m[1] - self.east_m[0]), float(self.north_m[1] - self.north_m[0])

    @property
    def shade(self) -> FloatArray:
        """(rows, columns) Brightness by `hill_shade`, 0 to 1; NaN beside holes."""
        east_m, north_m = np.meshgrid(self.east_m, self.north_m)
        shade = hill_shade(np.stack([east_m, north_m, self.up_m], axis=-1))
        return np.pad(shade, (0, 1), mode="edge")

    @property
    def slope_deg(self) -> FloatArray:
        """Inclination (rows, columns) by central differences; NaN at the edge, in and beside holes."""
        slope_deg = np.full(self.up_m.shape, np.nan)
        north, east = np.gradient(self.up_m, self.north_m, self.east_m)
        slope_deg[1:-1, 1:-1] = np.degrees(np.arctan(np.hypot(east, north)))[1:-1, 1:-1]
        slope_deg[np.isnan(self.up_m)] = np.nan  # differences over a hole of one sample do not contain it
        return slope_deg

    def to_json(self) -> dict[str, Any]:
        """The survey in figures."""
        slope_deg = self.slope_deg[np.isfinite(self.slope_deg)]
        known_m = self.up_m[np.isfinite(self.up_m)]
        document = {
            "description": self.description,
            "area_m": self.area._asdict(),
            "sampled_every_m": list(self.step_m),
            "lowest_m": float(known_m.min()) if known_m.size else None,
            "highest_m": float(known_m.max()) if known_m.size else None,
            "missing_share": float(np.isnan(self.up_m).mean()),
            "slope_deg": _percentiles(slope_deg),
            "footprint": None,
        }
        if self.footprint is not None:
            incidence_deg = self.footprint.incidence_deg
            document["footprint"] = {
                "area_m": self.footprint.area._asdict(),
                "no_ground_share": float(np.isnan(incidence_deg).mean()),
                "incidence_deg": _percentiles(incidence_deg[np.isfinite(incidence_deg)]),
            }
        return document


def survey_ground(scenario: FlightScenario) -> tuple[GroundSurvey, GroundSurvey | None]:
    """Survey the ground of a scenario with its static objects.

    Returns:
        The whole area of a grid or a mesh (of a plane or a sphere, the surroundings of the footprint), and the
        surroundings of the flight's footprint; None if the flight is not known before the run.

    Raises:
        InputError: a file cannot be used, or the flight leaves its ground.
    """
    ground = build_ground(scenario.site)
    scene = with_objects(ground, scenario.site)
    area, pixel_m = _area(ground)
    if scenario.live is not None:
        return _sampled(scene, area or _around(None), pixel_m, None), None
    footprint = _footprint(Flight(scenario))
    below = _sampled(scene, _around(footprint.area), pixel_m, footprint)
    return below if area is None else _sampled(scene, area, pixel_m, footprint), below


def _around(area: Rectangle | None) -> Rectangle:
    if area is None:
        return Rectangle(-_UNKNOWN_M, _UNKNOWN_M, -_UNKNOWN_M, _UNKNOWN_M)
    east_m, north_m = (area.west_m + area.east_m) / 2, (area.south_m + area.north_m) / 2
    side_m = max(area.east_m - area.west_m, area.north_m - area.south_m, 1.0)
    half_m = side_m * (0.5 + _MARGIN)
    return Rectangle(east_m - half_m, east_m + half_m, north_m - half_m, north_m + half_m)


def _sampled(
    scene: Scene, area: Rectangle, pixel_m: float | None, footprint: FlightFootprint | None
) -> GroundSurvey:
    sides_m = area.east_m - area.west_m, area.north_m - area.south_m
    step_m = max(sides_m) / (MOST_SAMPLES - 1)
    if pixel_m is not None:
        step_m = max(step_m, pixel_m)
    columns, rows = (max(round(side_m / step_m) + 1, 2) for side_m in sides_m)
    east_m, north_m = np.linspace(*area[:2], columns), np.linspace(*area[2:], rows)
    places = (place_m.ravel() for place_m in np.meshgrid(east_m, north_m))
    up_m = scene.height_m(*places).reshape(rows, columns)
    return GroundSurvey(scene.description, east_m, north_m, up_m, footprint)


def _area(ground: Scene) -> tuple[Rectangle | None, float | None]:
    while isinstance(ground, PaintedGround):
        ground = ground.ground
    if isinstance(ground, NestedGround):
        area, _ = _area(ground.outer)
        return area, None
    if isinstance(ground, MeshGround):
        return ground.area, None
    if isinstance(ground, GridGround):
        samples = ground.samples
        return extent(samples), min(samples.pixel_east_m, samples.pixel_north_m)
    return None, None


def _footprint(flight: Flight) -> FlightFootprint:
    shot = np.unique(
        np.linspace(0, flight.shot_count - 1, min(flight.shot_count, _MOST_SHOTS)).astype(np.int64)
    )
    pointing, _ = flight.point(shot, flight.scanner.initial)
    hits = flight.cast(pointing)
    cosine = -(pointing.true_site * hits.normal_site).sum(axis=-1)
    return FlightFootprint(
        pointing.sensor_site_m[:, 0],
        pointing.sensor_site_m + hits.range_m[..., None] * pointing.true_site,
        np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))),
    )


def _percentiles(values: FloatArray) -> dict[str, float] | None:
    if not values.size:
        return None
    median, high, largest = np.percentile(values, [50.0, 95.0, 100.0]).tolist()
    return {"median": median, "p95": high, "largest": largest}


_WIDEST_RATIO = 3.0
"""Largest ratio of the horizontal axes, so that a long approach stays readable."""
_STEEP = 0.995
"""Quantile of the slopes that is drawn darkest and brightest."""
_WIDTH_SHARE = 0.35
"""Half the width of the ground below a flight is at least this share of the height."""
_SUN_TANGENT = 0.45
"""Slope of the sun's rays over the slope of the steep parts of the ground."""
_LEAST_STEEP = 0.1
_PENUMBRA = 2.0
"""Depth below the shadow's edge at which a shadow is full, in falls of a ray over one sample."""


@dataclass(frozen=True)
class Extent:
    """The plotted box in the site frame."""

    low_m: FloatArray
    """(3,) East, north, up."""
    high_m: FloatArray
    """(3,) East, north, up."""

    def contain(self, points_m: FloatArray) -> BoolArray:
        """(...) Whether points (..., 3) are inside; NaN is not."""
        return np.asarray(np.all((points_m >= self.low_m) & (points_m <= self.high_m), axis=-1))

    def with_ground(self, factor: float = 1.0) -> Extent:
        """Widen the sides by a factor, and to a share of the height: a vertical path stands on some ground."""
        centre_m, half_m = (self.high_m + self.low_m) / 2, (self.high_m - self.low_m) / 2
        half_m[:2] = np.maximum(factor * half_m[:2], 2.0 * _WIDTH_SHARE * half_m[2])
        return Extent(centre_m - half_m, centre_m + half_m)


def extent_of(measurement: Measurement) -> Extent:
    """Compute the bounding box of path and hit points, with a margin and a least size.

    The hit points are the true ones of the beams that fired, which no fault displaces; without any, the measured ones.
    """
    hit = measurement.fired & np.isfinite(measurement.true_point_site_m[..., 2])
    known, points_m = (
        (hit, measurement.true_point_site_m)
        if hit.any()
        else (measurement.range_valid, measurement.point_site_m)
    )
    # Component by component: a copy of all points of an hour takes 35 MB.
    seen_m = (np.concatenate([measurement.position_site_m[:, k], points_m[..., k][known]]) for k in range(3))
    low_m, high_m = np.array([(np.nanmin(values), np.nanmax(values)) for values in seen_m]).T
    centre_m, half_m = (high_m + low_m) / 2, (high_m - low_m) / 2
    half_m[:2] = np.maximum(half_m[:2], max(half_m[:2].max() / _WIDEST_RATIO, 0.05 * half_m[2], 0.5)) * 1.08
    half_m[2] = max(half_m[2], 0.5) * 1.02
    return Extent(centre_m - half_m, centre_m + half_m)


def sample_ground(scene: Scene, extent: Extent, samples: int) -> FloatArray:
    """(n, n, 3) Sample points of the ground over the extent, rows to the north; up is NaN without ground."""
    axes_m = (np.linspace(extent.low_m[k], extent.high_m[k], samples) for k in range(2))
    east_m, north_m = np.meshgrid(*axes_m)
    up_m = scene.height_m(east_m.ravel(), north_m.ravel()).reshape(east_m.shape)
    return np.stack([east_m, north_m, up_m], axis=-1)


def hill_shade(ground_m: FloatArray) -> FloatArray:
    """(n-1, n-1) Brightness of each quadrilateral, 0 to 1, with cast shadows; the sun is in the north-west.

    Level ground has 0.6. The sun stands as high as makes the steep slopes of this ground contrast.
    """
    toward, steep = slope_to_sun(ground_m)
    known_m = ground_m[..., 2][np.isfinite(ground_m[..., 2])]
    # Where there is none, it casts no shadow.
    up_m = np.nan_to_num(ground_m[..., 2], nan=known_m.min(initial=0.0))
    step_m = float(np.diff(ground_m[0, :, 0]).mean() + np.diff(ground_m[:, 0, 1]).mean()) / 2
    # On ground that is level apart from objects, shadows would else have no end.
    fall_m = _SUN_TANGENT * max(steep, _LEAST_STEEP) * step_m
    horizon_m = up_m.copy()  # the height up to which a point lies in shadow, row by row away from the sun
    for row in reversed(range(len(up_m) - 1)):
        horizon_m[row, 1:] = np.maximum(up_m[row, 1:], horizon_m[row + 1, :-1] - fall_m)
    shadow = np.clip((horizon_m - up_m) / (_PENUMBRA * fall_m), 0.0, 1.0)[:-1, :-1]
    lit = 0.6 + 0.4 * toward
    return np.asarray(lit * (1.0 - 0.6 * shadow))


def slope_to_sun(ground_m: FloatArray) -> tuple[FloatArray, float]:
    """Compute slopes (n-1, n-1) toward the north-west, -1 to 1 in units of a steep slope, and the steep slope.

    Where elevation data end, a vertical face joins them to the level ground beyond; its slope is an artefact of the
    map's edge, and counts as level.
    """
    east_m, north_m, up_m = np.moveaxis(ground_m, -1, 0)
    rise_east = np.diff(up_m, axis=1)[:-1] / np.diff(east_m, axis=1)[:-1]
    rise_north = np.diff(up_m, axis=0)[:, :-1] / np.diff(north_m, axis=0)[:, :-1]
    facing: FloatArray = np.where(level_parts(up_m), 0.0, rise_east - rise_north)
    known = np.abs(facing[np.isfinite(facing) & (facing != 0.0)])
    steep = float(np.quantile(known, _STEEP)) if known.size else 0.0
    # Slopes below one in a thousand are rounding errors on level ground.
    steep = max(steep, 1e-3)
    return np.asarray(np.clip(facing / steep, -1.0, 1.0)), steep


def level_parts(up_m: FloatArray) -> BoolArray:
    """(n-1, n-1) Whether a quadrilateral has a corner on exactly level ground."""
    corners = np.stack([up_m[:-1, :-1], up_m[:-1, 1:], up_m[1:, 1:], up_m[1:, :-1]])
    level = np.ptp(corners, axis=0) == 0.0
    on_level = np.zeros(up_m.shape, dtype=np.bool_)
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            on_level[rows, columns] |= level
    return np.asarray(on_level[:-1, :-1] | on_level[:-1, 1:] | on_level[1:, 1:] | on_level[1:, :-1])


Elevation = npt.NDArray[np.float32]


def check_raster_path(path: Path, known: Collection[str]) -> None:
    """Check the path of an export before its content is computed.

    Raises:
        InputError: the suffix is not a known one, the folder is missing or read-only, or `.tif` lacks the extra `geo`.
    """
    check_suffix(path, known)
    if path.suffix == ".tif":
        check_extra(str(path), path.suffix, "rasterio", "geo")
    check_destination(path)


def export_ground(ground: Generated, elevation_m: Elevation, path: Path) -> None:
    """Write the elevations of a ground centred on the map's origin; rows run north to south, columns west to east.

    Raises:
        InputError: see `check_raster_path`.
        RunError: writing failed.
    """
    check_raster_path(path, GROUND_SUFFIXES)
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
    half_m = ground.size_m / 2
    return geotiff({"elevation": elevation_m}, ground.spacing_m, -half_m, half_m, {})


def geotiff(
    bands: dict[str, Elevation], spacing_m: float, west_m: float, north_m: float, tags: dict[str, float]
) -> bytes:
    """Encode bands (rows from north to south, columns from west to east) as a GeoTIFF.

    Args:
        bands: values by name; NaN: unknown.
        spacing_m: distance of samples.
        west_m, north_m: the first sample, from the origin of the site frame.
        tags: further numbers by name.
    """
    from rasterio import Affine
    from rasterio.io import MemoryFile

    rows, columns = next(iter(bands.values())).shape
    missing = any(bool(np.isnan(values).any()) for values in bands.values())
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=columns,
            height=rows,
            count=len(bands),
            dtype="float32",
            nodata=np.nan if missing else None,
            compress="deflate",
            predictor=3,
            # Metres from the origin of the site frame; the map is not on a body, so it has no projection. Samples are
            # at pixel centres; a GeoTIFF states the corner of the first pixel.
            transform=Affine(
                spacing_m, 0.0, west_m - spacing_m / 2, 0.0, -spacing_m, north_m + spacing_m / 2
            ),
        ) as file:
            for number, (name, values) in enumerate(bands.items(), start=1):
                file.write(values, number)
                file.set_band_description(number, name)
            file.update_tags(**tags)
        return bytes(memory.read())


def _asc(ground: Generated, elevation_m: Elevation) -> bytes:
    side = len(elevation_m)
    first_m = -ground.size_m / 2
    head = f"ncols {side}\nnrows {side}\nxllcenter {first_m!r}\nyllcenter {first_m!r}\ncellsize {ground.spacing_m!r}\n"
    rows = (" ".join(map("%.9g".__mod__, row)) for row in elevation_m.tolist())
    return (head + "\n".join(rows) + "\n").encode()


_WRITERS: dict[str, Callable[[Generated, Elevation], bytes]] = {".npz": _npz, ".tif": _tif, ".asc": _asc}
GROUND_SUFFIXES = tuple(_WRITERS)

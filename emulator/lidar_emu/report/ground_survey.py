"""A survey of a site's ground: heights and slopes over its area, and where the beams of the flight fall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lidar_emu.flight.flight import Flight
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.build import build_ground, with_objects
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.map_area import Rectangle
from lidar_emu.scene.mesh.ground import MeshGround
from lidar_emu.scene.mosaic.albedo import PaintedGround
from lidar_emu.scene.mosaic.nested import NestedGround
from lidar_emu.scene.ray_hits import Scene

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
        """Area of the lattice."""
        return Rectangle(*self.east_m[[0, -1]].tolist(), *self.north_m[[0, -1]].tolist())

    @property
    def step_m(self) -> tuple[float, float]:
        """Distances between columns and between rows."""
        return float(self.east_m[1] - self.east_m[0]), float(self.north_m[1] - self.north_m[0])

    @property
    def rise(self) -> tuple[FloatArray, FloatArray]:
        """Slopes (rows, columns) to the east and to the north, by central differences; NaN beside holes."""
        north, east = np.gradient(self.up_m, self.north_m, self.east_m)
        return np.asarray(east), np.asarray(north)

    @property
    def slope_deg(self) -> FloatArray:
        """Inclination (rows, columns)."""
        return np.degrees(np.arctan(np.hypot(*self.rise)))

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
        edges = *samples.east_m[[0, -1]].tolist(), *samples.north_m[[0, -1]].tolist()
        return Rectangle(*edges), min(samples.pixel_east_m, samples.pixel_north_m)
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

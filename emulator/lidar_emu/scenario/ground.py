"""Ground that is generated, and ground from a mesh."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.errors import Finding
from lidar_emu.scenario.section import Albedo, Latitude, Longitude, Part, Positive, Vector3, unusable


class Detail(Part):
    """Seeded fractal relief between the samples of a grid; the samples keep their heights. By default it continues
    the roughness of the grid at its finest scales."""

    spacing_m: Positive
    """The grid's pixel is halved until it is no longer than this."""
    below_m: Positive | None = None
    """Detail is generated where beams hit while the sensor is less than this above the origin of the site frame. Left
    out: wherever beams hit."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Another seed is another relief of the same statistics. The scenario's own seed does not change the ground."""
    hurst: Annotated[float, Field(ge=0.05, le=0.95)] | None = None
    """Hurst exponent. Left out: the grid's own, from differences over 1, 2 and 4 pixels."""
    rms_slope_deg: Annotated[float, Field(gt=0, lt=60)] | None = None
    """Arc tangent of the rms height difference over one pixel of the grid. Left out: the grid's own, without the
    contribution of slopes that are longer than a few pixels."""


LEAST_CELLS, MOST_CELLS = 32, 4096
CRATER_SAMPLES, ROCK_SAMPLES = 4, 2
"""Grid spacings across the smallest crater and the smallest rock that the grid resolves."""

Interpolation = Literal["bilinear", "triangles"]


class Relief(Part):
    """Fractional Brownian relief: the rms height difference between points r apart grows as r^H."""

    hurst: Annotated[float, Field(ge=0.05, le=0.99)] = 0.76
    """Hurst exponent H: 0.5 is a random walk, near 1 smooth. The lunar maria have about 0.76, the highlands 0.95."""
    rms_slope_deg: Annotated[float, Field(gt=0, lt=60)]
    """Arc tangent of the rms height difference over the baseline. Every seed gives exactly this value."""
    baseline_m: Positive
    """Distance over which this slope is taken: from `spacing_m` to a quarter of `size_m`."""


class Craters(Part):
    """Simple craters. The lunar production function for an age, limited to equilibrium where small craters erode as
    fast as they form."""

    age_gyr: Annotated[float, Field(ge=1e-6, le=4.4)]
    """Age of the surface; the production and the chronology follow Neukum et al. (2001) for the Moon."""
    depth_to_diameter: Annotated[float, Field(ge=0.02, le=0.3)] = 0.2
    """Depth of a fresh crater, from rim crest to floor, over its diameter. The rim is 0.18 times as high as the
    crater is deep."""
    smallest_diameter_m: Positive | None = None
    """Left out: four times `spacing_m`, what the grid resolves. For hazards alone, a larger one."""
    largest_diameter_m: Positive | None = None
    """Left out: a quarter of `size_m`."""


class MarsRocks(Part):
    """Rocks as on Mars: rocks larger than D cover the fraction k exp(-q D) of the ground, q = 1.79 + 0.152 / k per
    metre (Golombek and Rapp 1997)."""

    kind: Literal["golombek"]
    abundance: Annotated[float, Field(ge=0.005, le=0.4)]
    """k, the fraction of the ground covered by rocks of all sizes; 0.05 to 0.1 at landing sites, 0.2 is rocky."""
    smallest_diameter_m: Positive | None = None
    """Left out: twice `spacing_m`, what the grid resolves. For hazards alone, a larger one."""
    largest_diameter_m: Positive | None = None
    """Left out: 10 m, but at most a tenth of `size_m`."""


class PowerLawRocks(Part):
    """Rocks as on the Moon: N D^-b rocks per square metre are larger than D metres."""

    kind: Literal["power_law"]
    per_m2_over_1_m: Annotated[float, Field(gt=0, le=0.1)]
    """N, the number of rocks larger than 1 m per square metre."""
    exponent: Annotated[float, Field(gt=0, le=6)] = 2.6
    """Exponent b."""
    smallest_diameter_m: Positive | None = None
    """Left out: twice `spacing_m`, what the grid resolves. For hazards alone, a larger one."""
    largest_diameter_m: Positive | None = None
    """Left out: 10 m, but at most a tenth of `size_m`."""


Rocks = MarsRocks | PowerLawRocks


class Generated(Part):
    """Ground generated from these parameters: an elevation grid with the origin of the site frame at its centre. It
    is generated once and cached. `lidar-emu ground` displays it, measures it and exports it."""

    kind: Literal["generated"]
    size_m: Annotated[float, Field(gt=0, le=1e6)]
    """Side of the square, a whole number of spacings."""
    spacing_m: Annotated[float, Field(ge=1e-3)]
    """Distance between samples. At least 32 and at most 4096 fit into `size_m`."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Another seed is another ground with the same statistics. The scenario's own seed does not change the ground."""
    relief: Relief | None = None
    """Left out: level."""
    craters: Craters | None = None
    """Left out: none."""
    rocks: Annotated[Rocks, Field(discriminator="kind")] | None = None
    """Left out: none."""
    interpolation: Interpolation = "bilinear"
    """What spans the cells, as for a `grid`."""
    beyond: Literal["none", "plane", "sphere"] = "none"
    """What lies outside the grid: nothing, the level plane through the origin, or the body's sphere through it."""
    at_m: tuple[float, float] | None = None
    """Centre of the grid in the site frame, east and north, where there are several grids. Left out: at 0, 0."""
    detail: Detail | None = None
    """Relief between the samples. Left out: none."""

    @property
    def cells(self) -> int:
        """Spacings along a side."""
        return round(self.size_m / self.spacing_m)

    def _check(self) -> None:
        ratio = self.size_m / self.spacing_m
        if not LEAST_CELLS - 0.5 <= ratio <= MOST_CELLS + 0.5 or abs(ratio - self.cells) > 1e-6 * ratio:
            expected = f"such that size_m is {LEAST_CELLS} to {MOST_CELLS} whole spacings; it is {ratio:.9g}"
            raise unusable("spacing_m", self.spacing_m, expected)
        if self.relief is not None and not self.spacing_m <= self.relief.baseline_m <= self.size_m / 4:
            expected = f"from {self.spacing_m:g}, spacing_m, to {self.size_m / 4:g}, a quarter of size_m"
            raise unusable("relief.baseline_m", self.relief.baseline_m, expected)
        for name, samples in (("craters", CRATER_SAMPLES), ("rocks", ROCK_SAMPLES)):
            if getattr(self, name) is not None:
                self._check_diameters(name, samples * self.spacing_m)

    def _check_diameters(self, name: str, resolved_m: float) -> None:
        part: Craters | Rocks = getattr(self, name)
        smallest_m, largest_m = diameter_range_m(self, name)
        if smallest_m < resolved_m * (1 - 1e-9):
            expected = f"at least {resolved_m:g}, what the grid resolves"
            raise unusable(f"{name}.smallest_diameter_m", smallest_m, expected)
        if not smallest_m < largest_m <= self.size_m / 2:
            expected = f"above {smallest_m:g}, the smallest, and at most {self.size_m / 2:g}, half of size_m"
            key = "smallest" if part.largest_diameter_m is None else "largest"
            value = smallest_m if part.largest_diameter_m is None else largest_m
            raise unusable(f"{name}.{key}_diameter_m", value, expected)


def diameter_range_m(ground: Generated, name: str) -> tuple[float, float]:
    """Smallest and largest diameter of the `craters` or the `rocks` of a ground that has some."""
    part: Craters | Rocks = getattr(ground, name)
    if name == "craters":
        default_m = CRATER_SAMPLES * ground.spacing_m, ground.size_m / 4
    else:
        default_m = ROCK_SAMPLES * ground.spacing_m, min(10.0, ground.size_m / 10)
    smallest_m, largest_m = part.smallest_diameter_m, part.largest_diameter_m
    return (
        default_m[0] if smallest_m is None else smallest_m,
        default_m[1] if largest_m is None else largest_m,
    )


MeshUnit = Literal["m", "km"]


class MeshOrigin(Part):
    """Where on a mesh with body-fixed axes (z to the north pole, x to longitude 0) the origin of the site frame lies.
    Up is away from the body's centre. Left out: the file's axes are east, north, up and its zero is the origin."""

    latitude_deg: Latitude | None = None
    """Planetocentric latitude; the origin is the outermost point of the surface there."""
    longitude_deg: Longitude | None = None
    """East longitude."""
    body_fixed_m: Vector3 | None = None
    """Instead: the origin in metres along the body's axes."""

    def _check(self) -> None:
        given = self.latitude_deg is not None, self.longitude_deg is not None
        if given[0] != given[1]:
            missing = "longitude_deg" if given[0] else "latitude_deg"
            raise unusable(missing, Finding("missing"), "state latitude_deg and longitude_deg, or neither")
        if given[0] and self.body_fixed_m is not None:
            raise unusable("body_fixed_m", self.body_fixed_m, "left out beside latitude_deg, not both")
        if self.body_fixed_m is not None and not any(self.body_fixed_m):
            raise unusable("body_fixed_m", self.body_fixed_m, "a point that is not the body's centre")

    @property
    def is_body_fixed(self) -> bool:
        """Whether the file's axes are fixed to a body."""
        return self.latitude_deg is not None or self.body_fixed_m is not None


class Mesh(Part):
    """A triangle mesh. A closed one is solid; an open one whose triangles all face one way is ground below them."""

    kind: Literal["mesh"]
    file: str
    """OBJ, PLY, STL, a shape table (`.tab`), or a SPICE DSK (`.bds`). Relative to the file that names it."""
    unit: MeshUnit
    """Unit of the file's coordinates; `km` for a DSK."""
    material_reflectance: dict[str, Albedo] = {}
    """Albedo by the names of an OBJ's materials (`usemtl`), at the laser's wavelength. Others have
    `surface.reflectance`."""
    origin: MeshOrigin = MeshOrigin()
    """The point of the mesh that becomes the origin of the site frame."""

"""The site: body, ground, objects, reflectance and atmosphere."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.errors import Finding
from lidar_emu.scenario.ground import Detail, Generated, Interpolation, Mesh
from lidar_emu.scenario.objects import PlacedObject
from lidar_emu.scenario.section import Latitude, Longitude, NonNegative, Part, Positive, unusable

Slope = Annotated[float, Field(ge=0, lt=90)]
Wind = Annotated[float, Field(ge=-1000, le=1000)]


class Body(Part):
    """The celestial body. Its sphere is the altitude datum of the site."""

    name: str = "Moon"
    """Shown in plans and summaries."""
    radius_m: Annotated[float, Field(ge=1e-3)] = 1_737_400.0
    """Radius of the reference sphere: elevations are heights above it."""


class Plane(Part):
    """A plane through the origin of the site frame."""

    kind: Literal["plane"]
    slope_deg: Slope = 0.0
    """Inclination of the plane."""
    downhill_azimuth_deg: float = 0.0
    """Downhill direction, clockwise from north (for a slope across the track)."""


class Sphere(Part):
    """The reference sphere of the body; the site frame is tangent to it at the origin."""

    kind: Literal["sphere"]


class Origin(Part):
    """Where on the grid the origin of the site frame lies. Give one pair, or none for the grid's centre."""

    latitude_deg: Latitude | None = None
    """Planetocentric latitude (needs a georeferenced file)."""
    longitude_deg: Longitude | None = None
    """East longitude (needs a georeferenced file)."""
    map_x_m: float | None = None
    """Map easting in the file's own projection."""
    map_y_m: float | None = None
    """Map northing in the file's own projection."""

    def _check(self) -> None:
        for one, other in (("latitude_deg", "longitude_deg"), ("map_x_m", "map_y_m")):
            missing = [key for key in (one, other) if getattr(self, key) is None]
            if len(missing) == 1:
                raise unusable(missing[0], Finding("missing"), f"state {one} and {other}, or neither")
        if self.latitude_deg is not None and self.map_x_m is not None:
            raise unusable("map_x_m", self.map_x_m, "left out beside latitude_deg, not both")


class ElevationGrid(Part):
    """An elevation grid; the ground is a surface through its samples."""

    kind: Literal["grid"]
    file: str
    """GeoTIFF, PDS label (`.lbl`, not the `.img` beside it) or ESRI ASCII (extra `geo`), a point cloud (`.las`, `.laz`,
    extra `points`; `.xyz`), or `.npz` with `elevation_m` (rows from north to south), `pixel_m` and, optionally,
    `map_x_m`, `map_y_m` of the first sample. Relative to the file that names it."""
    band: str | Annotated[int, Field(ge=1)] = "elevation"
    """Band by its description, or by number from 1. A file of one band needs neither."""
    pixel_m: Annotated[float, Field(ge=1e-3)] | None = None
    """Distance between samples: of a file that states none, such as a picture or an array, and of the grid that a point
    cloud is made into by the mean height around each sample. Other files state their own."""
    nodata: float | None = None
    """Value that marks missing samples, if the file does not state it. Infinite and NaN samples are always missing."""
    elevation_scale: Positive | None = None
    """Metres per unit of the file. Left out: from the unit that the file states, else 1."""
    elevation_offset_m: float = 0.0
    """Added after scaling: shifts the file's vertical datum to the site's sphere."""
    origin: Origin = Origin()
    """The point of the map that becomes the origin of the site frame."""
    placement: Literal["projected", "flat"] = "projected"
    """`projected`: placed by the file's map projection in a frame tangent to the body at the origin, north to the
    pole; the map is resampled there, and the ground falls away with the body's curvature. `flat`: the map's plane is
    the horizontal plane and its north is north, as for files without a projection."""
    half_size_m: Positive | None = None
    """Extent of a projected grid from the origin to the east, west, north and south. Left out: to the edge of the
    file, at most 1000 samples and a tenth of the body's radius."""
    reflectance_band: str | Annotated[int, Field(ge=1)] | None = None
    """Band with the albedo at the laser's wavelength, 0 to 1. `surface.reflectance` applies where samples are
    missing."""
    rock_abundance_band: str | Annotated[int, Field(ge=1)] | None = None
    """Band with the fraction of the area covered by rocks, 0 to 1; shown by `plan`, otherwise unused."""
    interpolation: Interpolation = "bilinear"
    """What spans the cell between four samples: one bilinear patch, or two triangles that share the diagonal from
    south-west to north-east. Ranges are measured to this surface: it is the ground truth."""
    beyond: Literal["none", "plane", "sphere"] = "none"
    """What lies outside the grid: no surface (beams that leave the grid have no echo), the level plane through the
    origin, or the body's sphere through the origin. Missing samples count as outside."""
    at_m: tuple[float, float] | None = None
    """Origin of the grid in the site frame, east and north, where there are several grids. Left out: at 0, 0."""
    detail: Detail | None = None
    """Relief between the samples. Left out: none."""


AnyGrid = ElevationGrid | Generated


class Nested(Part):
    """Nested grids: at each point the first grid that has a sample there applies. Each grid is blended into the next
    ones over a strip along its edge and around its holes, so that the surface has no steps there. The strip is four
    pixels of the wider grid wide, and at most a quarter of the finer one's side."""

    kind: Literal["nested"]
    grids: Annotated[
        list[Annotated[AnyGrid, Field(discriminator="kind")]],
        Field(min_length=2, max_length=16),
    ]
    """The grids, from the finest to the widest. The origin of the first is the origin of the site frame; another grid
    whose `origin` and `at_m` are left out is aligned to the same point of the map. The last one states what lies
    beyond."""

    @property
    def beyond(self) -> Literal["none", "plane", "sphere"]:
        """What lies outside all grids."""
        return self.grids[-1].beyond

    def _check(self) -> None:
        for place, grid in enumerate(self.grids[:-1]):
            if grid.beyond != "none":
                expected = "none; the last of the grids states what lies beyond"
                raise unusable(f"grids.{place}.beyond", grid.beyond, expected)


class Surface(Part):
    """How the ground reflects at the laser's wavelength."""

    reflectance: Annotated[float, Field(ge=0, le=1)] = 0.18
    """Lambertian albedo at normal incidence."""
    lommel_seeliger_share: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Fraction L in `L + (1 - L) cos(incidence)`; 0: Lambert, 1: the Moon at zero phase angle, about 0.5: Mars."""
    roughness_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Root mean square height of what is smaller than a footprint, such as gravel: ranges scatter by 0.86 of it over
    the cosine of incidence. Larger relief is the ground's own."""


class Atmosphere(Part):
    """A homogeneous thin atmosphere; its particles of haze return light, too."""

    extinction_per_m: NonNegative
    """Extinction coefficient; the echo loses exp(-2 · extinction · range)."""
    backscatter_per_m_sr: NonNegative = 0.0
    """Backscatter coefficient of the air itself; about 1e-7 in clear Martian air."""
    wind_mps: tuple[Wind, Wind, Wind] = (0.0, 0.0, 0.0)
    """Velocity of the haze to the east, to the north and up. Haze at rest has the Doppler shift of the ground in the
    constant segment."""


class Site(Part):
    """A landing site."""

    name: str = "site"
    """Shown in plans and summaries."""
    body: Body = Body()
    """The body and its altitude datum."""
    ground: Annotated[Plane | Sphere | ElevationGrid | Generated | Nested | Mesh, Field(discriminator="kind")]
    """Shape of the ground."""
    objects: list[PlacedObject] = []
    """Objects on the ground or moving above it."""
    origin_altitude_m: float | None = None
    """Height of the site frame's origin above the body's sphere. Left out: the ground's own height at the origin (0
    for a plane, a sphere, and a mesh that is not body-fixed), so that altitudes count from the ground at the landing
    point. For a trajectory that counts altitudes from another datum."""
    surface: Surface = Surface()
    """Reflectance of the ground."""
    atmosphere: Atmosphere | None = None
    """Left out: vacuum."""
    sunlight_w_per_m2_um: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    """Spectral irradiance of the ground by the sun at the laser's wavelength; about 270 on the Moon and 117 on Mars
    at 1550 nm; 0 at night."""

    @property
    def is_smooth(self) -> bool:
        """Whether the ground is a formula, without objects on it."""
        return isinstance(self.ground, Plane | Sphere) and not self.objects

    @property
    def has_edges(self) -> bool:
        """Whether surfaces may end within a footprint; the facets of a grid meet."""
        return isinstance(self.ground, Mesh) or bool(self.objects)

    def _check(self) -> None:
        names = [each.name for each in self.objects]
        for number, name in enumerate(names):
            if name in names[:number]:
                raise unusable(f"objects.{number}.name", name, "a name that no other object has")


Share = Annotated[float, Field(ge=0, le=1)]
Depth = Annotated[float, Field(ge=0, le=50)]


class Plume(Part):
    """A sheet of dust that blows outward over the ground; see docs/flights.md. Heights are heights of the sensor
    above the ground. All keys are for a lander of known thrust over known soil: no data fit them."""

    onset_height_m: Positive = 30.0
    """Dust is raised below this height; the amount grows linearly down to `full_height_m`."""
    full_height_m: Annotated[float, Field(ge=0)] = 12.0
    """The amount of dust is constant below this height."""
    optical_depth: Depth = 0.5
    """Optical depth of the sheet at full height, once through it straight down: the ground's echo loses
    exp(-2 · depth)."""
    thickness_m: Positive = 1.0
    """Thickness of the sheet above the ground."""
    lidar_ratio_sr: Annotated[float, Field(ge=1, le=1000)] = 50.0
    """Extinction over backscatter of the dust; with a smaller ratio the dust's own echo is stronger."""
    streak_share: Share = 0.05
    """Probability, at full height, that a beam meets a dense streak in a shot."""
    streak_optical_depth: Depth = 3.0
    """Optical depth of a streak, once through it."""
    speed_mps: Annotated[float, Field(ge=0, le=3000)] = 20.0
    """Outward speed of the dust over the ground, away from below the vehicle."""
    speed_spread: Share = 0.5
    """Speeds of the particles are uniform within this fraction of `speed_mps` around it."""

    def _check(self) -> None:
        if self.full_height_m >= self.onset_height_m:
            raise unusable(
                "full_height_m", self.full_height_m, f"below {self.onset_height_m:g}, onset_height_m"
            )

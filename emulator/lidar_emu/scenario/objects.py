"""Objects that stand on the ground of a site, lie there, or move above it."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lidar_emu.errors import Finding
from lidar_emu.scenario.mesh_ground import MeshUnit
from lidar_emu.scenario.part import NonNegative, Part, Positive, Vector3, unusable

MOST_COPIES = 100_000

Angle = Annotated[float, Field(ge=-360, le=360)]


class Scatter(Part):
    """Copies of an object, each turned at random, at random places around its own. Every one stands on the ground."""

    count: Annotated[int, Field(ge=1, le=MOST_COPIES)]
    """How many."""
    radius_m: Positive
    """Radius of the disc about `east_m`, `north_m` over which they are spread evenly."""
    scale: tuple[Positive, Positive] = (1.0, 1.0)
    """Least and greatest size, relative to the object's own; in between all octaves are alike."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Another seed is another arrangement. The scenario's own seed does not change it."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.scale[0] > self.scale[1]:
            raise unusable("scale", list(self.scale), "the least size first")
        return self


class TimedPlace(Part):
    """Where an object is at a time."""

    time_s: NonNegative
    """Since the start of the flight."""
    east_m: float
    """Of its place."""
    north_m: float
    """Of its place."""
    up_m: float
    """Of its place, above the origin of the site frame."""


class Motion(Part):
    """How an object moves. Its own speed is in the closing speed of what hits it."""

    velocity_mps: Vector3 | None = None
    """East, north and up, from its place at the start."""
    waypoints: Annotated[list[TimedPlace], Field(min_length=1)] | None = None
    """Instead: straight from one to the next, at rest before the first and after the last. They replace its place."""
    turn_rate_dps: Annotated[float, Field(ge=-3600, le=3600)] = 0.0
    """Degrees per second about the upward axis through its place, clockwise as seen from above."""

    @model_validator(mode="after")
    def _one_path(self) -> Self:
        if self.velocity_mps is not None and self.waypoints is not None:
            raise unusable("velocity_mps", list(self.velocity_mps), "velocity_mps or waypoints, not both")
        times_s = [waypoint.time_s for waypoint in self.waypoints or ()]
        for k, (before, after) in enumerate(pairwise(times_s)):
            if not before < after:
                raise unusable(f"waypoints.{k + 1}.time_s", after, f"later than the one before, {before:g}")
        return self


class Placed(Part):
    """What all objects have in common. An object's own axes are forward, right and up; its place is the point of the
    ground that it stands on."""

    name: str
    """Of this object alone."""
    east_m: float = 0.0
    """Place, from the origin of the site frame."""
    north_m: float = 0.0
    """Place, from the origin of the site frame."""
    up_m: float | None = None
    """Height of the place. Left out: on the ground there."""
    yaw_deg: Angle = 0.0
    """Where forward points, clockwise from north."""
    pitch_deg: Angle = 0.0
    """How far forward points up."""
    roll_deg: Angle = 0.0
    """How far right is turned down."""
    reflectance: Annotated[float, Field(ge=0, le=1)] | None = None
    """Albedo. Left out: the site's."""
    scatter: Scatter | None = None
    """Left out: there is one."""
    motion: Motion | None = None
    """Left out: it stays where it is."""

    @model_validator(mode="after")
    def _one_or_many(self) -> Self:
        if self.scatter is not None and self.motion is not None:
            raise unusable("motion", Finding("given beside scatter"), "one of the two")
        if self.scatter is not None and self.up_m is not None:
            raise unusable("up_m", self.up_m, "none beside scatter: copies stand on the ground")
        return self


class Boulder(Placed):
    """The upper half of an ellipsoid on the ground, and the lower half below."""

    kind: Literal["boulder"]
    """Chooses this object."""
    diameter_m: Positive
    """Across."""
    height_m: Positive | None = None
    """Above the ground. Left out: half the diameter."""


class Slab(Placed):
    """A box with a level top."""

    kind: Literal["slab"]
    """Chooses this object."""
    length_m: Positive
    """Forward."""
    width_m: Positive
    """To the right."""
    height_m: Positive
    """Above its place."""


class Cliff(Placed):
    """A step: a face, a level top behind it, and an upright back. It faces backward: yaw is where one goes up."""

    kind: Literal["cliff"]
    """Chooses this object."""
    length_m: Positive
    """Length of the top, forward of the edge."""
    width_m: Positive
    """Of the face."""
    height_m: Positive
    """Of the face."""
    face_deg: Annotated[float, Field(ge=5, le=90)] = 90.0
    """How steep the face is."""


class RampObject(Placed):
    """A wedge that rises forward from the ground, to an upright back."""

    kind: Literal["ramp"]
    """Chooses this object."""
    length_m: Positive
    """Forward."""
    width_m: Positive
    """To the right."""
    height_m: Positive
    """Height of the far end."""


class Tree(Placed):
    """An upright trunk, and an ellipsoid for its crown."""

    kind: Literal["tree"]
    """Chooses this object."""
    height_m: Positive
    """Height of the top of the crown."""
    crown_diameter_m: Positive
    """Across."""
    crown_base_m: NonNegative | None = None
    """Height of the lowest point of the crown. Left out: a third of `height_m`."""
    trunk_diameter_m: Positive | None = None
    """Left out: a tenth of `crown_diameter_m`."""

    @model_validator(mode="after")
    def _stands(self) -> Self:
        if self.crown_base_m is not None and not self.crown_base_m < self.height_m:
            raise unusable("crown_base_m", self.crown_base_m, f"below height_m, {self.height_m:g}")
        return self


class Pad(Placed):
    """A round landing pad with a level top."""

    kind: Literal["pad"]
    """Chooses this object."""
    diameter_m: Positive
    """Across."""
    height_m: Positive = 0.1
    """Above its place."""


class MeshObject(Placed):
    """A mesh from a file, whose axes are forward, left and up; its zero is the object's place."""

    kind: Literal["mesh"]
    """Chooses this object."""
    file: str
    """OBJ, PLY or STL (extra `mesh`). Relative to the file that names it."""
    unit: MeshUnit
    """Unit of the file's coordinates."""
    scale: Positive = 1.0
    """How many times larger it is than the file says."""


PlacedObject = Annotated[
    Boulder | Slab | Cliff | RampObject | Tree | Pad | MeshObject, Field(discriminator="kind")
]

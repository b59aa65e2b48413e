"""Objects on the ground of a site, or moving above it."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.errors import Finding
from lidar_emu.scenario.ground import MeshUnit
from lidar_emu.scenario.section import Albedo, NonNegative, Part, Positive, Vector3, unusable

MOST_COPIES = 100_000

Angle = Annotated[float, Field(ge=-360, le=360)]


class Scatter(Part):
    """Copies of an object at random positions and headings around its own position. Every copy stands on the ground."""

    count: Annotated[int, Field(ge=1, le=MOST_COPIES)]
    """Number of copies."""
    radius_m: Positive
    """Radius of the disc about `east_m`, `north_m` in which copies are uniformly distributed."""
    scale: tuple[Positive, Positive] = (1.0, 1.0)
    """Smallest and largest size relative to the object's own; the logarithm of the size is uniform."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Another seed is another arrangement. The scenario's own seed does not change it."""

    def _check(self) -> None:
        if self.scale[0] > self.scale[1]:
            raise unusable("scale", list(self.scale), "in order, the smallest size first")


class TimedPlace(Part):
    """A waypoint of an object."""

    time_s: NonNegative
    """Time since the start of the flight."""
    east_m: float
    """East coordinate, from the origin of the site frame."""
    north_m: float
    """North coordinate, from the origin of the site frame."""
    up_m: float
    """Height above the origin of the site frame."""


class Motion(Part):
    """Motion of an object. The closing speed of beams that hit it includes its velocity."""

    velocity_mps: Vector3 | None = None
    """Constant velocity east, north and up, from its position at the start."""
    waypoints: Annotated[list[TimedPlace], Field(min_length=1)] | None = None
    """Instead of its position: straight legs between waypoints, at rest before the first and after the last."""

    def _check(self) -> None:
        if self.velocity_mps is not None and self.waypoints is not None:
            raise unusable("velocity_mps", list(self.velocity_mps), "left out beside waypoints, not both")
        times_s = [waypoint.time_s for waypoint in self.waypoints or ()]
        for k, (before, after) in enumerate(pairwise(times_s)):
            if not before < after:
                raise unusable(f"waypoints.{k + 1}.time_s", after, f"later than the one before, {before:g}")


class Placed(Part):
    """Keys of every object. An object's axes are forward, right and up; its position is the point of the ground that
    it stands on."""

    name: str
    """Unique name."""
    east_m: float = 0.0
    """East coordinate of its position, from the origin of the site frame."""
    north_m: float = 0.0
    """North coordinate of its position, from the origin of the site frame."""
    up_m: float | None = None
    """Height of its position above the origin of the site frame. Left out: on the ground."""
    yaw_deg: Angle = 0.0
    """Heading of the forward axis, clockwise from north."""
    pitch_deg: Angle = 0.0
    """Angle of the forward axis above the horizontal."""
    reflectance: Albedo | None = None
    """Albedo. Left out: the site's."""
    scatter: Scatter | None = None
    """Left out: a single object."""
    motion: Motion | None = None
    """Left out: at rest."""

    def _check(self) -> None:
        if self.scatter is not None and self.motion is not None:
            raise unusable("motion", Finding("given beside scatter"), "use one of the two")
        if self.scatter is not None and self.up_m is not None:
            raise unusable("up_m", self.up_m, "left out beside scatter: copies stand on the ground")


class Boulder(Placed):
    """An ellipsoid on the ground, with its lower half below."""

    kind: Literal["boulder"]
    diameter_m: Positive
    """Horizontal diameter."""
    height_m: Positive | None = None
    """Height above the ground. Left out: half the diameter."""


class Slab(Placed):
    """A box with a level top."""

    kind: Literal["slab"]
    length_m: Positive
    """Length along the forward axis."""
    width_m: Positive
    """Width along the right axis."""
    height_m: Positive
    """Height above its position."""


class Cliff(Placed):
    """A step: a face, a level top behind it, and a vertical back. The face looks backward, so that the way up is
    forward."""

    kind: Literal["cliff"]
    length_m: Positive
    """Length of the top, forward of the edge."""
    width_m: Positive
    """Width of the face."""
    height_m: Positive
    """Height of the face."""
    face_deg: Annotated[float, Field(ge=5, le=90)] = 90.0
    """Inclination of the face."""


class RampObject(Placed):
    """A wedge that rises forward from the ground to a vertical back."""

    kind: Literal["ramp"]
    length_m: Positive
    """Length along the forward axis."""
    width_m: Positive
    """Width along the right axis."""
    height_m: Positive
    """Height of the far end."""


class Tree(Placed):
    """A vertical trunk with an ellipsoidal crown, which begins at a third of the height."""

    kind: Literal["tree"]
    height_m: Positive
    """Height of the top of the crown."""
    crown_diameter_m: Positive
    """Diameter of the crown."""


class Pad(Placed):
    """A round landing pad with a level top."""

    kind: Literal["pad"]
    diameter_m: Positive
    """Diameter of the top."""
    height_m: Positive = 0.1
    """Height above its position."""


class MeshObject(Placed):
    """A mesh from a file, whose axes are forward, left and up; its origin is the object's position."""

    kind: Literal["mesh"]
    file: str
    """OBJ, PLY or STL. Relative to the file that names it."""
    unit: MeshUnit
    """Unit of the file's coordinates."""
    material_reflectance: dict[str, Albedo] = {}
    """Albedo by the names of an OBJ's materials (`usemtl`). Others have `reflectance`."""
    scale: Positive = 1.0
    """Scale factor on the file's coordinates."""


PlacedObject = Annotated[
    Boulder | Slab | Cliff | RampObject | Tree | Pad | MeshObject, Field(discriminator="kind")
]

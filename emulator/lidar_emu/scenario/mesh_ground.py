"""Ground from a triangle mesh: a piece of land, or a whole small body."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from lidar_emu.errors import Finding
from lidar_emu.scenario.section import Albedo, Latitude, Longitude, Part, Vector3, unusable

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

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        given = self.latitude_deg is not None, self.longitude_deg is not None
        if given[0] != given[1]:
            missing = "longitude_deg" if given[0] else "latitude_deg"
            raise unusable(missing, Finding("missing"), "state latitude_deg and longitude_deg, or neither")
        if given[0] and self.body_fixed_m is not None:
            raise unusable("body_fixed_m", self.body_fixed_m, "left out beside latitude_deg, not both")
        if self.body_fixed_m is not None and not any(self.body_fixed_m):
            raise unusable("body_fixed_m", self.body_fixed_m, "a point that is not the body's centre")
        return self

    @property
    def is_body_fixed(self) -> bool:
        """Whether the file's axes are fixed to a body."""
        return self.latitude_deg is not None or self.body_fixed_m is not None


class Mesh(Part):
    """A triangle mesh. A closed one is solid; an open one whose triangles all face one way is ground below them."""

    kind: Literal["mesh"]
    """Chooses this kind of ground."""
    file: str
    """OBJ, PLY or STL (the latter two with extra `mesh`), a shape table (`.tab`), or a SPICE DSK (`.bds`, extra
    `spice`). Relative to the file that names it."""
    unit: MeshUnit
    """Unit of the file's coordinates; `km` for a DSK."""
    material_reflectance: dict[str, Albedo] = {}
    """Albedo by the names of an OBJ's materials (`usemtl`), at the laser's wavelength. Others have
    `surface.reflectance`."""
    origin: MeshOrigin = MeshOrigin()
    """The point of the mesh that becomes the origin of the site frame."""

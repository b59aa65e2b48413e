"""Relief below the pixel of an elevation grid."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lidar_emu.scenario.section import Part, Positive


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

"""A bench pattern: constants and ramps instead of physics, to check a driver on day one."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Discriminator, Field, Tag, model_validator

from lidar_emu.scenario.section import Part, Switch, unusable


class Ramp(Part):
    """Sawtooth from `start` to `stop`, repeated."""

    start: float
    """Value at the start of each period."""
    stop: float
    """Value that it approaches at the end of each period."""
    period_s: Annotated[float, Field(ge=1e-6, le=1e7)]
    """Length of a period."""


def _kind_of_level(value: object) -> str:
    return "ramp" if isinstance(value, dict | Ramp) else "constant"


Level = Annotated[
    Annotated[float, Tag("constant")] | Annotated[Ramp, Tag("ramp")],
    Discriminator(_kind_of_level),
]


class BenchBeam(Part):
    """What one beam reports."""

    range_m: Level
    """Constant or ramp; never negative."""
    closing_speed_mps: Level
    """Constant or ramp; positive toward the ground."""
    snr_db: float = 20.0
    """Reported signal-to-noise ratio."""
    valid: Switch = True
    """`off`: the beam reports that it found no surface."""

    @model_validator(mode="after")
    def _range_is_a_range(self) -> Self:
        level = self.range_m
        if isinstance(level, Ramp):
            stated = {"range_m.start": level.start, "range_m.stop": level.stop}
        else:
            stated = {"range_m": level}
        for key, value in stated.items():
            if value < 0:
                raise unusable(key, value, "greater than or equal to 0")
        return self


class BenchPattern(Part):
    """Constants and ramps of each beam, in place of instrument, site, trajectory and scanner."""

    beams: Annotated[list[BenchBeam], Field(min_length=1, max_length=64)]
    """The beams, from 0."""
    duration_s: Annotated[float, Field(gt=0, le=1e7)]
    """Length of the pattern."""

"""A bench pattern: constants and ramps instead of physics, to check a driver on day one."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Discriminator, Field, Tag, model_validator

from lidar_emu.scenario.part import NonNegative, Part, Positive, Switch


class Ramp(Part):
    """A saw tooth."""

    start: float
    """Value at the start of each period."""
    stop: float
    """Value that it approaches at the end of each period."""
    period_s: Positive
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
        lowest = (
            min(self.range_m.start, self.range_m.stop) if isinstance(self.range_m, Ramp) else self.range_m
        )
        if lowest < 0:
            raise ValueError("range_m must not be negative")
        return self


class BenchPattern(Part):
    """Instead of instrument, site, trajectory and scanner."""

    beams: Annotated[list[BenchBeam], Field(min_length=1, max_length=64)]
    """The beams, from 0."""
    duration_s: Positive
    """Length of the pattern."""
    latency_s: NonNegative = 2.9e-3
    """From a shot's start to its packet."""

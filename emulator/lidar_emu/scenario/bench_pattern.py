"""A bench pattern: constants and ramps instead of physics, to check a driver on day one."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Discriminator, Field, Tag, model_validator

from lidar_emu.scenario.part import NonNegative, Part, Positive, Switch, unusable


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
        ramp = self.range_m if isinstance(self.range_m, Ramp) else None
        stated = {"range_m.start": ramp.start, "range_m.stop": ramp.stop} if ramp else {"range_m": self.range_m}
        for key, value in stated.items():
            if value < 0:
                raise unusable(key, value, "greater than or equal to 0")
        return self


class BenchPattern(Part):
    """Instead of instrument, site, trajectory and scanner."""

    beams: Annotated[list[BenchBeam], Field(min_length=1, max_length=64)]
    """The beams, from 0."""
    duration_s: Positive
    """Length of the pattern."""
    latency_s: NonNegative = 2.9e-3
    """From a shot's start to its packet."""

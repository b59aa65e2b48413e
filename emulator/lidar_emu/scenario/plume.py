"""Dust that the engine's plume raises from the ground."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from lidar_emu.scenario.section import Part, Positive, unusable

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

    @model_validator(mode="after")
    def _grows_downward(self) -> Self:
        if self.full_height_m >= self.onset_height_m:
            raise unusable(
                "full_height_m", self.full_height_m, f"below {self.onset_height_m:g}, onset_height_m"
            )
        return self

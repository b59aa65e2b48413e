"""Vibration of the vehicle where the lidar is mounted."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lidar_emu.errors import Finding
from lidar_emu.scenario.section import Part, unusable

_Frequency = Annotated[float, Field(ge=10, le=10_000)]
_Density = Annotated[float, Field(ge=1e-12, le=1e3)]


class VibrationSpectrum(Part):
    """Spectral density of the acceleration along one axis: `g2_per_hz`, or `g_rms`, or a shape with its rms."""

    frequency_hz: Annotated[list[_Frequency], Field(min_length=2, max_length=64)] = [20.0, 2000.0]
    """Frequencies of the points, ascending (slower motion belongs to the trajectory)."""
    g2_per_hz: Annotated[list[_Density], Field(min_length=2, max_length=64)] | None = None
    """One-sided density there, in g²/Hz; straight lines join the points on logarithmic scales. Left out: flat."""
    g_rms: Annotated[float, Field(gt=0, le=100)] | None = None
    """Rms of the acceleration, to which the density is scaled. Left out: the density as stated."""

    def _check(self) -> None:
        if sorted(set(self.frequency_hz)) != self.frequency_hz:
            raise unusable("frequency_hz", self.frequency_hz, "ascending")
        if self.g2_per_hz is None and self.g_rms is None:
            raise unusable("g_rms", Finding("missing"), "state g_rms, or g2_per_hz")
        if self.g2_per_hz is not None and len(self.g2_per_hz) != len(self.frequency_hz):
            raise unusable("g2_per_hz", self.g2_per_hz, "as long as frequency_hz")


class Vibration(Part):
    """Random vibration along the axes of the body, independent of each other: `vibration: {along_z: {g_rms: 1}}`."""

    along_x: VibrationSpectrum | None = None
    """Forward. Left out: none."""
    along_y: VibrationSpectrum | None = None
    """To the right. Left out: none."""
    along_z: VibrationSpectrum | None = None
    """Down. Left out: none."""

    @property
    def axes(self) -> tuple[VibrationSpectrum | None, ...]:
        """Spectra along x, y and z."""
        return self.along_x, self.along_y, self.along_z

"""Input and output of the receiver: echoes and returns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, Column, FloatArray, columns, missing_columns


class Reason(IntEnum):
    """Reason why a beam has no valid range and speed; the codes are sent over the wire."""

    VALID = 0
    NOT_FIRED = 1
    NO_SURFACE = 2
    """No beamlet hits a surface."""
    BELOW_THRESHOLD = 3
    """The echo was not detected in all three segments."""
    BEYOND_RANGE = 4
    """The measured range, or the surface itself, is beyond the instrument's maximum range."""
    INSIDE_GROUND = 5
    """The sensor touches the ground or is below it, at some time of the measurement."""
    AMBIGUOUS = 6
    """No choice of signs and folds gives a range that the instrument can measure, or the three frequencies do not
    belong to one surface (`lidar_emu.receiver.target_pairs`)."""


class FalseTarget(IntEnum):
    """Source of a peak that is not the surface's."""

    NONE = 0
    BACK_REFLECTION = 1
    """Light that window and optics reflect."""
    SIDE_LINE = 2
    """Side line of the surface's line by a periodic non-linearity of the chirps."""
    LEAKAGE = 3
    """Echo of another beam."""
    HAZE = 4
    """Backscatter of the atmosphere."""
    DUST = 5
    """Dust of the plume."""


NO_DUST = np.zeros((0, 0, 0))
"""`Echoes.dust` of beams without dust."""

NO_STREAKS = np.zeros((0, 0))
"""`Echoes.streak_drift_per_s` of beams without dust."""

FACE, COSINE_A, COSINE_B, ACROSS_A, ACROSS_B, ALONG = range(6)
"""Columns of `Echoes.speckle_place`."""

TRAVEL, DRIFT_A, DRIFT_B = range(3)
"""Columns of `Echoes.speckle_motion`."""

DUST_W, DUST_NEAR_M, DUST_FAR_M, DUST_DEPTH, DUST_SLOWEST_MPS, DUST_FASTEST_MPS = range(6)
"""Columns of `Echoes.dust`."""


class Echoes(NamedTuple):
    """Echoes of all beamlets of all beams, for kernels."""

    range_m: FloatArray
    """(shots, beams, beamlets) Range at the time of validity; NaN where a beamlet has no hit."""
    closing_speed_mps: FloatArray
    """(shots, beams, beamlets) Closing speed of the ground at the time of validity; positive toward the sensor."""
    power_w: FloatArray
    """(shots, beams, beamlets) Power in the mode of the local oscillator (`coherent_power_w` times the beamlet's
    weight); 0 where a beamlet has no hit."""
    range_rate_mps: FloatArray
    """(shots, beams, beamlets) Rate of `range_m` as the moving beam slides over the ground; it differs from minus the
    closing speed unless the beam stays at the same point."""
    closing_acceleration_mps2: FloatArray
    """(shots, beams) Rate of the closing speed along the moving beam."""
    closing_jerk_mps3: FloatArray
    """(shots, beams) Rate of `closing_acceleration_mps2`; 0 where the run leaves it out."""
    range_curvature_mps2: FloatArray
    """(shots, beams) Rate of `range_rate_mps` on the axis; 0 where the run leaves it out."""
    air_speed_mps: FloatArray
    """(shots, beams) Closing speed of the air along the axis, which all haze on it has."""
    speckle_place: FloatArray
    """(shots, beams, 6) Direction of the beam and place of the sensor in the field of `receiver.speckle_field`: face of
    the cube, 0 for a beam whose speckle is another one in each shot; the two smaller components of the axis, in the
    frame of the ground; the sensor's place across it in metres, as the derivatives of its product with a direction by
    these components; and its place along the axis."""
    speckle_motion: FloatArray
    """(shots, beams, 3) Motion of the speckle within a measurement: pitches per second (`receiver.speckle`), and the
    rates of the place across the axis in m/s."""
    fired: BoolArray
    """(shots, beams) Whether the beam fires."""
    inside: BoolArray
    """(shots, beams) Whether the sensor is below the ground."""
    dust: FloatArray = NO_DUST
    """(shots, beams, 6) Dust before the surface: power in the mode of the local oscillator, ranges of its ends, its
    optical depth, lowest and highest closing speed, over which its light is uniform. Empty without dust."""
    streak_drift_per_s: FloatArray = NO_STREAKS
    """(shots, beams) Motion of a streak of dust across the beam, in pitches of the speckle; NaN where a beam
    meets none. Its beamlet is the first behind the footprint's. Empty without dust."""


_FLAGS = ("fired", "inside")


def contiguous_echoes(echoes: Echoes) -> Echoes:
    """Echoes in C order, float64 except flags: kernels are compiled for this layout alone."""
    arrays: dict[str, Any] = {
        name: np.ascontiguousarray(values, dtype=np.bool_ if name in _FLAGS else np.float64)
        for name, values in zip(Echoes._fields, echoes, strict=True)
    }
    return Echoes(**arrays)


@dataclass(frozen=True)
class BeamReport:
    """Report of the instrument on each beam, (shots, beams); NaN where a value is missing."""

    range_m: Annotated[FloatArray, Column("f8", "m", "Measured range.")]
    closing_speed_mps: Annotated[
        FloatArray, Column("f8", "m/s", "Measured closing speed, positive toward the ground.")
    ]
    range_valid: Annotated[BoolArray, Column("?", "", "Whether the range is valid.")]
    speed_valid: Annotated[BoolArray, Column("?", "", "Whether the closing speed is valid.")]
    sign_resolved: Annotated[
        BoolArray,
        Column(
            "?",
            "",
            "Whether the speed's sign and the beats' folds are unambiguous, among speeds up to λ fs/4.",
        ),
    ]
    """And for a surface within the record edge (12.2 km and 232.5 m/s with the default instrument): beyond that speed
    every segment equals its alias, which no shot alone can tell. The rules are in `receiver.range_speed_estimation`."""
    reason: Annotated[
        NDArray[np.int8],
        Column(
            "i1",
            "",
            "Why a beam is invalid, a code of `lidar_emu.receiver.returns.Reason`.",
            missing=Reason.NOT_FIRED,
        ),
    ]
    segments: Annotated[
        NDArray[np.uint8],
        Column("u1", "", "Segments with a detection: bit 0 up-chirp, bit 1 constant, bit 2 down-chirp."),
    ]
    snr_db: Annotated[
        FloatArray,
        Column(
            "f8", "dB", "Signal-to-noise ratio without clipping's noise, mean of segments with a detection."
        ),
    ]
    """Power of the highest bin relative to the noise behind the poles of a record that is not clipped, referred to a
    rectangular bin: with a flat receiver, the number of photons detected for a tone on its bin."""
    residual_mps: Annotated[
        FloatArray, Column("f8", "m/s", "Speed from the two chirps less speed from the constant segment.")
    ]
    """λ (g₋ - g₊ - 2 g₀) / 4."""
    sigma_range_m: Annotated[
        FloatArray, Column("f8", "m", "Standard deviation of the range that the instrument states.")
    ]
    """From noise, the laser's keys and what the peaks show of speckle; bias by motion is not included. See
    `stated_variance`. NaN for invalid measurements."""
    range_degrees_of_freedom: Annotated[
        FloatArray,
        Column("f8", "", "Degrees of freedom of Student's law for the error over its sigma; 1000: Gaussian."),
    ]
    """See `footprint_depth`."""
    sigma_speed_mps: Annotated[
        FloatArray, Column("f8", "m/s", "Standard deviation of the closing speed that the instrument states.")
    ]
    returns: Annotated[
        NDArray[np.uint8], Column("u1", "", "Surfaces that all three segments see, at most 4.")
    ]
    """See `target_pairs`."""
    second_range_m: Annotated[FloatArray, Column("f8", "m", "Range of the second strongest surface.")]
    second_sigma_range_m: Annotated[
        FloatArray, Column("f8", "m", "Standard deviation of `second_range_m` that the instrument states.")
    ]
    second_reason: Annotated[
        NDArray[np.int8],
        Column(
            "i1",
            "",
            "Why there is no second range, a code as in `reason`.",
            missing=Reason.NOT_FIRED,
        ),
    ]
    """BELOW_THRESHOLD where no chirp has a second target, AMBIGUOUS where one has, but of no surface."""


@dataclass(frozen=True)
class Returns(BeamReport):
    """Report of a beam with the peaks that it derives from."""

    segment_peak_hz: Annotated[
        FloatArray,
        Column(
            "f8",
            "Hz",
            "Beat of the surface, or the strongest, in up-chirp, constant segment, down-chirp.",
            components=(3,),
        ),
    ]
    speckle_bin2: Annotated[
        FloatArray,
        Column(
            "f8",
            "",
            "Speckle in the variances of both ranges in bins², and square of the range's quadrature.",
            components=(2, 2),
        ),
    ]
    """A row for `range_m` and one for `second_range_m`; see `stated_variance.SpeckleVariance`."""

    @classmethod
    def with_columns(cls, shape: tuple[int, ...], **known: NDArray[Any]) -> Self:
        """Build returns of this shape from some columns; the others have their missing value."""
        return cls(**missing_columns(RETURN_COLUMNS, known, shape), **known)

    def report(self) -> dict[str, NDArray[Any]]:
        """Columns of `BeamReport` by name."""
        arrays = vars(self)
        return {name: arrays[name] for name in REPORT_COLUMNS}


REPORT_COLUMNS = columns(BeamReport)
RETURN_COLUMNS = columns(Returns)

"""Records that the receiver's kernels share: the beam being measured, and a target of a spectrum."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from lidar_emu.numerics.arrays import FloatArray

MAX_TARGETS = 4
"""Maximum number of targets kept per spectrum, the strongest."""


class Beam(Protocol):
    """The beam being measured: a record of BEAM."""

    seed: np.uint64
    shot: int
    beam: int
    closing_acceleration_mps2: float
    closing_jerk_mps3: float
    range_curvature_mps2: float
    beamlets: int
    """Beamlets of all beams, with light or without."""
    columns: int
    """Columns in use for beamlets."""
    lit_beamlets: int
    power_w: float
    """Power of all light."""
    speckle_level: int
    """See `speckle.needed_level`."""
    speckle_phase: float
    """Position at the time of validity on the path of the speckle, in pitches; see `speckle.draw_speckle`."""
    travel_per_s: float
    """Pitches of the speckle that the footprint travels in a second."""
    streak_drift_per_s: float
    """Motion of a streak of dust across the beam, in pitches; -1 without one."""
    air_speed_mps: float
    haze_range_m: float
    haze_snr: float
    haze_beats: FloatArray
    """(2,) Ends of the haze's band in a record; see `volume_light`."""
    dust_snr: float
    dust: FloatArray
    """(6,) Row of `Echoes.dust`."""
    dust_beats: FloatArray
    """(3,) Middle, half width and length of the dust's band in a record; see `volume_light`."""
    filter_taps: int
    """Taps of the filter on each side."""
    left_out_bin2: float
    """Variance of a beat below which a stage is left out."""
    gain: float
    distortion: float
    """Gain and distortion of the digitiser in the segment being measured, from `analog_response.clipping`."""


_TYPES = {"np.uint64": "u8", "int": "i8", "float": "f8", "FloatArray": "f8", "bool": "?"}
_LENGTHS = {"haze_beats": (2,), "dust": (6,), "dust_beats": (3,), "speckle_bin2": (2,)}

BEAM = np.dtype(
    [(name, _TYPES[kind], _LENGTHS.get(name, ())) for name, kind in Beam.__annotations__.items()], align=True
)


class SpectrumTarget(Protocol):
    """A target of one spectrum: a record of TARGET."""

    frequency_bin: float
    variance_bin2: float
    """Variance of the frequency: by noise, until `stated_variance.state_variances`."""
    quadrature_bin: float
    quadrature_bin2: float
    quadrature_variance_bin2: float
    drift_bin: float
    """See `peak_shape.PeakShape`."""
    width_bin2: float
    power_over_noise: float
    power: float
    """Power of its highest bin."""


TARGET: Any = np.dtype([(name, "f8") for name in SpectrumTarget.__annotations__], align=True)


class Candidate(Protocol):
    """Three targets that may belong to one surface: a record of CANDIDATE."""

    up: int
    """Numbers of the three segments' targets, 0 for the strongest."""
    constant: int
    down: int
    state: int
    """See `target_pairs`."""
    receding: bool
    """Whether the up-chirp has the higher beat."""
    power: float
    """Power of the chirps' targets that determine the range."""
    range_bin: float
    doppler_bin: float
    range_variance: float
    doppler_variance: float
    speckle_bin2: FloatArray
    """(2,) Row of `Returns.speckle_bin2`."""
    residual_bin: float
    limit_bin: float
    """Largest residual of one surface."""
    close_bin: float
    """Largest residual where chance has many triples to choose from."""
    sign_resolved: bool


CANDIDATE: Any = np.dtype(
    [(name, _TYPES[kind], _LENGTHS.get(name, ())) for name, kind in Candidate.__annotations__.items()],
    align=True,
)

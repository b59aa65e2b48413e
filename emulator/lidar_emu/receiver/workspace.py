"""Arrays that the receiver's kernels write to, and the records of a beam and a target."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel, with_fields
from lidar_emu.receiver.close_tones import TONES_PER_DIVISION
from lidar_emu.receiver.laser_phase_noise import LineArrays, line_arrays
from lidar_emu.receiver.motion_smear import LEAST_TAPS
from lidar_emu.receiver.speckle import SpeckleChange, SpeckleField, speckle_change, speckle_field, tone_count
from lidar_emu.receiver.spectrum import REACH, ROWS, grid_capacity

SEGMENT_INDICES = 2**24
"""Random number indices reserved for the bins of each record; N is at most 2**24."""

VOLUME_NODES = 64
"""Parts of the bands of haze and dust in `volume_nodes`."""

MAX_TARGETS = 4
"""Maximum number of targets kept per spectrum, the strongest."""

BEAM = np.dtype(
    [
        ("seed", "u8"),
        ("shot", "i8"),
        ("beam", "i8"),
        ("closing_acceleration_mps2", "f8"),
        ("closing_jerk_mps3", "f8"),
        ("range_curvature_mps2", "f8"),
        ("speckle_place", "f8", (2,)),
        ("speckle_drift_per_s", "f8", (2,)),
        ("streak_drift_per_s", "f8"),
        ("lit_beamlets", "i8"),
        ("power_w", "f8"),
        ("air_speed_mps", "f8"),
        ("haze_range_m", "f8"),
        ("haze_snr", "f8"),
        ("haze_beats", "f8", (2,)),
        ("dust_snr", "f8"),
        ("dust", "f8", (6,)),
        ("dust_beats", "f8", (3,)),
        ("filter_taps", "i8"),
        ("speckle_level", "i8"),
        ("left_out_bin2", "f8"),
    ],
    align=True,
)
"""The beam being measured: seed, shot and beam number for the random numbers; motion and speckle as in `Echoes`, the
streak's drift -1 without one; number of beamlets with light, the power of all light, closing speed, end, SNR and beats
of the haze, SNR, row of `Echoes.dust` and beats of the dust (`volume_light`), the taps of the filter on each side, the
level of `speckle.needed_level`, and the variance of a beat below which a stage is left out."""

TARGET = np.dtype(
    [
        ("frequency_bin", "f8"),
        ("variance_bin2", "f8"),
        ("quadrature_bin", "f8"),
        ("quadrature_bin2", "f8"),
        ("quadrature_variance_bin2", "f8"),
        ("drift_bin", "f8"),
        ("width_bin2", "f8"),
        ("power_over_noise", "f8"),
        ("power", "f8"),
    ],
    align=True,
)
"""A target of one spectrum: frequency and its variance, by noise until `stated_variance.state_variances`; quadrature,
its square averaged over looks, its variance by noise, change of the frequency from look to look, and width, as in
`peak_shape`; power of its highest bin."""


class Workspace(NamedTuple):
    """Arrays of a beam; their size limits beamlets and looks."""

    beam: NDArray[Any]
    """(1,) Record of BEAM."""
    beamlets: FloatArray
    """(5, tones) See `gather_beamlets`; one column per beamlet, and at least one more for the haze."""
    tones: FloatArray
    """(looks, 4 tones) Buffer of `look_tones`."""
    speckle: SpeckleField
    change: SpeckleChange
    laser_line: LineArrays
    targets: NDArray[Any]
    """(3, MAX_TARGETS) Targets of each segment, records of TARGET, strongest first."""
    alarms: NDArray[Any]
    """(MAX_TARGETS,) Noise peaks, records of TARGET, strongest first."""
    volume_peaks: NDArray[Any]
    """(MAX_TARGETS,) Peaks of haze and dust in bins that are not computed, records of TARGET, strongest first."""
    volume_nodes: FloatArray
    """(VOLUME_NODES, 5) Buffer of `detection.draw_volume_peaks`."""


class SpectrumWorkspace(NamedTuple):
    """Arrays for the bins of spectra; their size limits beamlets, looks and the widest filter."""

    places: FloatArray
    """(2, places) Nearest bins of all tones, one look after another, after places in the band of haze; last the
    back-reflection's. A buffer to sort them."""
    residues: FloatArray
    grid: FloatArray
    bins: FloatArray
    filtered: FloatArray
    noise: FloatArray
    words: NDArray[np.uint64]
    taps: FloatArray
    """(4, 2, taps) Taps of the smear, of the linewidth, of both, and of the ripple."""
    peaks: NDArray[np.int64]


def build_workspace(beamlets: int, looks: int, speckle_level: int = 0, taps: int = 0) -> Workspace:
    """Allocate arrays for beams of up to `beamlets` beamlets, whose speckle changes up to this level, and lines of the
    laser of `taps` taps on each side."""
    columns = _columns(beamlets)
    tones = int(tone_count(speckle_level))
    return Workspace(
        beam=with_fields(np.zeros(1, dtype=BEAM)),
        beamlets=np.empty((5, columns)),
        tones=np.zeros((looks, 4 * tones * columns)),
        speckle=speckle_field(columns, tones),
        change=speckle_change(columns, speckle_level),
        laser_line=line_arrays(taps),
        targets=with_fields(np.empty((3, MAX_TARGETS), dtype=TARGET)),
        alarms=with_fields(np.empty(MAX_TARGETS, dtype=TARGET)),
        volume_peaks=with_fields(np.empty(MAX_TARGETS, dtype=TARGET)),
        volume_nodes=np.empty((VOLUME_NODES, 5)),
    )


def plain(work: Workspace) -> tuple[Any, ...]:
    """Arrays of a workspace as plain tuples, for calls from Python."""
    return tuple(tuple(part) if isinstance(part, tuple) else part for part in work)


@kernel
def as_workspace(arrays: tuple[Any, ...]) -> Workspace:
    """Workspace from the tuples of `plain`."""
    beam, beamlets, tones, field, change, laser, targets, alarms, peaks, nodes = arrays
    speckle, line = (SpeckleField(*field), SpeckleChange(*change)), LineArrays(*laser)
    return Workspace(beam, beamlets, tones, *speckle, line, targets, alarms, peaks, nodes)


@kernel(inline="always")
def look_tones(work: Workspace, beam: Any, look: int) -> FloatArray:
    """Tones of one record, (4, tones), see `set_tones`: one column per beamlet for each tone of its speckle."""
    count = work.beamlets.shape[1] * tone_count(beam.speckle_level)
    tones: FloatArray = work.tones[look][: 4 * count].reshape((4, count))
    return tones


def build_spectrum_workspace(
    beamlets: int, looks: int, taps: int, length: float, speckle_level: int = 0, band: float = 0.0
) -> SpectrumWorkspace:
    """Allocate arrays for beams of up to `beamlets` beamlets, whose speckle changes up to this level, filters of `taps`
    taps on each side, and bands of haze and dust of `band` bins."""
    tones = _columns(beamlets) * int(tone_count(speckle_level))
    reach = REACH + max(0, taps - LEAST_TAPS)
    places = looks * tones + 1 + (int(band) // (2 * reach + 1) + 6 if band > 0.0 else 0)
    capacity = grid_capacity(places, reach, length)
    return SpectrumWorkspace(
        places=np.empty((2, places)),
        residues=np.empty((2, tones)),
        grid=np.empty((ROWS, capacity)),
        bins=np.empty((looks, 2, capacity)),
        filtered=np.empty((4, capacity + 2 * taps + 4)),
        noise=np.empty((2, capacity + 4)),
        words=np.empty((4, capacity // 2 + 4), dtype=np.uint64),
        taps=np.empty((4, 2, 2 * taps + 1)),
        peaks=np.empty(MAX_TARGETS, dtype=np.int64),
    )


def _columns(beamlets: int) -> int:
    """Columns for the beamlets and the haze, padded to whole vectors of tones."""
    return -(-(beamlets + 1) // TONES_PER_DIVISION) * TONES_PER_DIVISION

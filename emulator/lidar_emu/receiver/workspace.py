"""Arrays that the receiver's kernels write to."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, IntArray, SingleArray
from lidar_emu.numerics.kernels import kernel, with_fields
from lidar_emu.numerics.random_streams import Normals, normals
from lidar_emu.receiver.laser_phase_noise import LineArrays, line_arrays
from lidar_emu.receiver.motion_smear import LEAST_TAPS
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import BEAM, CANDIDATE, MAX_TARGETS, TARGET, Beam
from lidar_emu.receiver.speckle import SpeckleWork, as_speckle_work, corner_numbers, speckle_work, tone_count
from lidar_emu.receiver.spectrum import LANES, REACH, ROWS, grid_capacity

VOLUME_NODES = 64
"""Parts of the bands of haze and dust in `volume_nodes`."""


class Workspace(NamedTuple):
    """Arrays of a beam; their size limits beamlets, looks, bands and the widest filter.

    Records are numbered by segment + 3 look, and rows of tones and bins are longer than what is in use.
    """

    beam: NDArray[Any]
    """(1,) Record of BEAM."""
    beamlets: FloatArray
    """(5, columns) See `gather_beamlets`; one column per beamlet, and at least one more for the haze."""
    beats: FloatArray
    """(records, columns) Signed beats of the beamlets."""
    tones: SingleArray
    """(records, 4, tones) n, δ and weight: one column per beamlet for each tone of its speckle."""
    speckle: SpeckleWork
    drawn: Normals
    """The numbers of the speckle, then noise and laser line of each record."""
    offsets: IntArray
    """(records, 2) Column of the first number of noise and line."""
    laser_line: LineArrays
    taps: SingleArray
    """(4, 2, taps) Taps of the smear, of the linewidth, of both, and of the ripple."""
    grid: SingleArray
    """(3, ROWS, capacity) See `spectrum`."""
    ends: IntArray
    """(3, places + 1) See `spectrum.lay_bins`."""
    bins: SingleArray
    """(3, looks, 2, capacity) Rectangular bins of each record."""
    places: SingleArray
    """(2, places) Nearest bins of all tones, one look after another, after places in the band of haze; last the
    back-reflection's. A buffer to sort them."""
    residues: SingleArray
    """(2, tones) Overwritten."""
    filtered: SingleArray
    """(6, capacity + taps) Overwritten."""
    wide: FloatArray
    """(4, capacity) Overwritten."""
    targets: NDArray[Any]
    """(3, MAX_TARGETS) Targets of each segment, records of TARGET, strongest first."""
    counts: IntArray
    """(3,) Number of targets of each segment."""
    triple: NDArray[Any]
    """(3,) Targets of a candidate, records of TARGET."""
    candidates: NDArray[Any]
    """(MAX_TARGETS³,) Records of CANDIDATE; the first is of the strongest targets."""
    peaks: IntArray
    """(MAX_TARGETS,) Columns of the groups' highest bins."""
    alarms: NDArray[Any]
    """(MAX_TARGETS,) Noise peaks, records of TARGET, strongest first."""
    volume_peaks: NDArray[Any]
    """(MAX_TARGETS,) Peaks of haze and dust in bins that are not computed, records of TARGET, strongest first."""
    volume_nodes: FloatArray
    """(VOLUME_NODES, 5) Buffer of `detection.draw_volume_peaks`."""


def build_workspace(
    model: ReceiverModel, beamlets: int, speckle_level: int = 0, taps: int = 0, dust_bins: float = 0.0
) -> Workspace:
    """Allocate arrays for beams of up to `beamlets` beamlets, whose speckle changes up to this level, filters of `taps`
    taps on each side, and bands of dust of up to `dust_bins` bins."""
    looks, columns = model.looks, -(-(beamlets + 1) // LANES) * LANES
    tones = columns * int(tone_count(speckle_level))
    reach = REACH + max(0, taps - LEAST_TAPS)
    band = model.haze.computed_range_m * model.beat_bin_per_m + dust_bins
    places = looks * tones + 1 + (int(band) // (2 * reach + 1) + 6 if band > 0.0 else 0)
    capacity = grid_capacity(places, reach, model.fft_length)
    line = line_arrays(taps)
    # Each interval may have a number more at either end.
    record_numbers = capacity + 2 * places + line.phasors.shape[1] + 2 * taps + 4
    records = 2.0 * model.furthest_record_s / model.record_time_s + 1.0
    corners = corner_numbers(columns, speckle_level, records)

    def single(*shape: int) -> SingleArray:
        return np.zeros(shape, dtype=np.float32)

    return Workspace(
        beam=with_fields(np.zeros(1, dtype=BEAM)),
        beamlets=np.zeros((5, columns)),
        beats=np.zeros((3 * looks, columns)),
        tones=single(3 * looks, 4, tones),
        speckle=speckle_work(columns, speckle_level),
        drawn=normals(corners + 3 * looks * record_numbers),
        offsets=np.zeros((3 * looks, 2), dtype=np.int64),
        laser_line=line,
        taps=single(4, 2, 2 * taps + 1),
        grid=single(3, ROWS, capacity),
        ends=np.zeros((3, places + 1), dtype=np.int64),
        bins=single(3, looks, 2, capacity),
        places=single(2, places),
        residues=single(2, tones),
        filtered=single(6, capacity + 2 * taps + LANES),
        wide=np.empty((4, capacity)),
        targets=with_fields(np.empty((3, MAX_TARGETS), dtype=TARGET)),
        counts=np.zeros(3, dtype=np.int64),
        triple=with_fields(np.empty(3, dtype=TARGET)),
        candidates=with_fields(np.empty(MAX_TARGETS**3, dtype=CANDIDATE)),
        peaks=np.empty(MAX_TARGETS, dtype=np.int64),
        alarms=with_fields(np.empty(MAX_TARGETS, dtype=TARGET)),
        volume_peaks=with_fields(np.empty(MAX_TARGETS, dtype=TARGET)),
        volume_nodes=np.empty((VOLUME_NODES, 5)),
    )


def plain(work: tuple[Any, ...]) -> tuple[Any, ...]:
    """Arrays of a workspace as plain tuples, for calls from Python."""
    return tuple(plain(part) if isinstance(part, tuple) else part for part in work)


@kernel
def as_workspace(arrays: tuple[Any, ...]) -> Workspace:
    """Workspace from the tuples of `plain`."""
    beam, beamlets, beats, tones, speckle, drawn, offsets, line, taps = arrays[:9]
    grid, ends, bins, places, residues, filtered, wide = arrays[9:16]
    targets, counts, triple, candidates, peaks, alarms, volume_peaks, volume_nodes = arrays[16:]
    return Workspace(
        beam, beamlets, beats, tones, as_speckle_work(speckle), Normals(*drawn), offsets, LineArrays(*line),
        taps, grid, ends, bins, places, residues, filtered, wide, targets, counts, triple, candidates, peaks, alarms,
        volume_peaks, volume_nodes,
    )  # fmt: skip


@kernel
def tones_in_use(beam: Beam) -> int:
    """Columns of a record's tones."""
    return beam.columns * tone_count(beam.speckle_level)

"""Three methods for the spectrum of one segment: sample by sample, as published, and bin by bin.

python -m benchmarks.spectra [SCENARIO]    descent.yaml unless another flight is named; see docs/evidence/accuracy.md
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from benchmarks.echo_field import echo_field
from benchmarks.published_spectrum import Deposit, build_published_spectrum, published_bins
from benchmarks.tables import command_line
from lidar_emu.beams.flight import Flight
from lidar_emu.bench.settings import light, median_times_s
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.beat_tones import signed_bin
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.spectrum import (
    BIN,
    LANES,
    REACH,
    ROWS,
    TAPS,
    WINDOWS,
    SpectralWindow,
    fold,
    grid_capacity,
    lay_bins,
)
from lidar_emu.receiver.tone_bins import set_close_tones, set_tones, tones_are_close
from lidar_emu.scenario.load import load, require_flight
from lidar_emu.scenario.schema import FlightScenario

BEAMLETS = 61
_DOWN = 2
_SEGMENTS = 64
_CHECKED = 2
_PUBLISHED: tuple[tuple[Deposit, int], ...] = (
    ("nearest", 2048),
    ("nearest", 4096),
    ("cubic", 2048),
    ("cubic", 4096),
)
_OVERSAMPLE = 8
_MARGIN_BINS = 16.0

_ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class SpectrumMethod:
    """A method for the windowed bins of a segment."""

    name: str
    time_s: float
    """Time per segment."""
    error: float
    """Largest complex error near the tones, relative to the spectrum's peak; 0 for the FFT, the reference."""


def compare_spectra(scenario: FlightScenario, flight: Flight, rounds: int = 7) -> list[SpectrumMethod]:
    """Compute down-chirp spectra of the first beam, 61 beamlets each, along the flight by three methods.

    The FFT's time includes the synthesis of the record's samples, one beamlet after another; the published method and
    the bins are timed over blocks of segments, which excludes Python's overhead.
    """
    window = WINDOWS[scenario.instrument.detection.window]
    length = scenario.instrument.waveform.fft_length
    tones = _tones(scenario, flight)
    lowest = tones[:, 0].min(axis=1)
    first = np.floor(lowest - _MARGIN_BINS)
    exact = [_record_bins(one, length, window) for one in tones[:_CHECKED]]

    names, errors = ["samples and FFT"], [0.0]
    jobs: list[Callable[[], object]] = [partial(_record_bins, tones[0], length, window)]
    widest = float((tones[:, 0].max(axis=1) - lowest).max()) + 2 * _MARGIN_BINS
    for deposit, points in _PUBLISHED:
        # The kernel goes round the ring: what is read must lie within half of it.
        if widest > points / _OVERSAMPLE / 2:
            continue
        published = build_published_spectrum(window, length, points, _OVERSAMPLE, deposit)
        names.append(f"published, {deposit}, {points} points")
        jobs.append(partial(published_bins, published, tones, first))
        got = published_bins(published, tones[:_CHECKED], first[:_CHECKED])
        errors.append(_error(got, first, exact, tones))
    product = _Product(tones, float(length), window)
    names.append("bin by bin")
    jobs.append(product.run)
    product.run()
    errors.append(_error(product.out, product.first, exact, tones))
    times_s = median_times_s(jobs, rounds)
    per_segment = [times_s[0], *(time_s / len(tones) for time_s in times_s[1:])]
    return [SpectrumMethod(*row) for row in zip(names, per_segment, errors, strict=True)]


def ratio_to_published(methods: list[SpectrumMethod]) -> float | None:
    """Time of the fastest published spectrum to that of bin by bin, the last; None: none was wide enough."""
    published_s = [method.time_s for method in methods if method.name.startswith("published")]
    return min(published_s) / methods[-1].time_s if published_s else None


def _tones(scenario: FlightScenario, flight: Flight) -> FloatArray:
    """(segments, 4, tones) n, δ and weights of the first beam's down-chirps; in whole vectors of tones."""
    shot = np.unique(np.linspace(0, flight.shot_count - 1, _SEGMENTS).astype(np.int64))
    model = build_receiver(scenario.instrument, scenario.site)
    echoes = light(scenario, flight, BEAMLETS, shot)
    field = echo_field(model, echoes, shot, scenario.seed).at_centre()[:, 0, _DOWN]
    tones = np.zeros((len(shot), 4, -(-BEAMLETS // LANES) * LANES))
    for s in range(len(shot)):
        for i in range(BEAMLETS):
            range_m, speed_mps = echoes.range_m[s, 0, i], echoes.closing_speed_mps[s, 0, i]
            place, real, imaginary = fold(signed_bin(model, _DOWN, range_m, speed_mps), model.fft_length)
            weight = field[s, i]
            tones[s, :, i] = (
                np.rint(place),
                place - np.rint(place),
                real * weight.real,
                imaginary * weight.imag,
            )
        tones[s, :2, BEAMLETS:] = tones[s, :2, :1]
    lit = np.isfinite(tones).all(axis=(1, 2)) & tones[:, 2:].any(axis=(1, 2))
    return tones[lit]


def _record_bins(tones: FloatArray, length: int, window: SpectralWindow) -> _ComplexArray:
    """All bins of one record, from its samples; phases are reduced in whole numbers, so that none loses digits."""
    samples = np.zeros(length)
    _synthesise(tones, length, samples)
    ripple = np.cos(2 * np.pi * np.arange(length) / length)
    spectrum = rfft(samples * (window.centre + 2 * window.side * ripple)) * (2 / length)
    return np.asarray(spectrum * np.exp(-1j * np.pi * np.arange(length // 2 + 1) / length))


@kernel(outermost=True)
def _synthesise(tones: FloatArray, length: int, samples: FloatArray) -> None:
    for i in range(tones.shape[1]):
        n = int(tones[0, i])
        for m in range(length):
            halves = 2 * m - (length - 1)
            turns = float((n * halves) % (2 * length)) + tones[1, i] * halves
            phase = np.pi * turns / length
            samples[m] += tones[2, i] * np.cos(phase) - tones[3, i] * np.sin(phase)


class _Product:
    """Arrays for the bins of `receiver.spectrum`, laid out once as a run does."""

    def __init__(self, tones: FloatArray, length: float, window: SpectralWindow) -> None:
        self.tones, self.length, self.window = tones.astype(np.float32), length, window
        self.snr = float(np.square(tones[:, 2:]).sum(axis=(1, 2)).mean())
        capacity = grid_capacity(tones.shape[2], REACH, length)
        self.grid, self.ends = np.zeros((ROWS, capacity), np.float32), np.zeros(tones.shape[2] + 1, np.int64)
        self.bins, self.scratch = (
            np.zeros((2, capacity), np.float32),
            np.empty((2, tones.shape[2]), np.float32),
        )
        self.wide = np.empty((4, capacity))
        self.out = np.zeros((len(tones), capacity), dtype=complex)
        self.first = np.empty(len(tones))

    def run(self) -> None:
        """All segments."""
        arrays = self.grid, self.ends, self.bins, self.scratch, self.wide
        _bin_by_bin(self.tones, self.snr, self.length, self.window, arrays, self.out, self.first)


@kernel(outermost=True)
def _bin_by_bin(
    tones: Any, snr: float, length: float, window: SpectralWindow, arrays: Any, out: Any, first: FloatArray
) -> None:
    grid, ends, bins, scratch, wide = arrays
    columns = tones.shape[2]
    side_re, side_im = window.side * np.cos(np.pi / length), window.side * np.sin(np.pi / length)
    for s in range(len(tones)):
        count = lay_bins(tones[s, 0], float(REACH), length, scratch[0], grid, ends)
        if tones_are_close(length, grid, count, snr):
            set_close_tones(tones[s], columns, length, grid, count, bins, scratch)
        else:
            set_tones(tones[s], columns, length, grid, count, bins, wide)
        first[s] = grid[BIN, 0]
        for j in range(TAPS, count - TAPS):
            below, here = complex(bins[0, j - 1], bins[1, j - 1]), complex(bins[0, j], bins[1, j])
            above = complex(bins[0, j + 1], bins[1, j + 1])
            out[s, j] = window.centre * here + side_re * (below + above) + 1j * side_im * (above - below)


def _error(got: _ComplexArray, first: FloatArray, exact: list[_ComplexArray], tones: FloatArray) -> float:
    """Largest complex error, over the peak, in the bins up to three away from tones."""
    worst = 0.0
    for s, whole in enumerate(exact):
        near = (tones[s, 0][:, None] + np.arange(-3.0, 4.0)).ravel()
        k = np.unique(near).astype(np.int64)
        k = k[(k > 0) & (k < len(whole) - 1)]
        apart = np.abs(got[s, k - int(first[s])] - whole[k])
        worst = max(worst, float(apart.max() / np.abs(whole).max()))
    return worst


def main(scenario_name: str) -> None:
    """Print time and error of each method."""
    scenario = require_flight(load(scenario_name))
    methods = compare_spectra(scenario, Flight(scenario))
    print("| spectrum | us per segment | largest complex error over the peak |\n|---|---|---|")
    for method in methods:
        print(f"| {method.name} | {1e6 * method.time_s:.3g} | {method.error:.1g} |")
    if (ratio := ratio_to_published(methods)) is not None:
        print(f"ratio: {ratio:.3g} (time of the fastest published spectrum to ours)")


if __name__ == "__main__":
    parser = command_line(__doc__)
    parser.add_argument("scenario", nargs="?", default="descent.yaml")
    main(parser.parse_args().scenario)

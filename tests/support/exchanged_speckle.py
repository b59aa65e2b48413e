"""Scatter of sub-bin peaks by speckle in closed form: a Gaussian process in place of light, motion and geometry.

As a beam glides over level ground straight below it, its field is a stationary circular Gaussian process with the
correlation exp(-(v t / w0)²), through up-chirp, constant segment and down-chirp alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

WAIST_M, RECORD_S, SEGMENT_S = 0.017, 2**17 / 600e6, 300e-6
RANGE_BIN_M, SPEED_BIN_MPS = 0.3430853, 3.547668e-3
_PARTS = 128
_DESIGN = np.array([[1.0, -1.0], [0.0, 1.0], [1.0, 1.0]])


class Peaks(NamedTuple):
    """Peaks of the three records, (shots, 3): three Hann bins about the highest Hamming bin."""

    error_bin: np.ndarray
    """Error of the signed beat. The up-chirp's beat falls as the Doppler shift grows."""
    variance_bin2: np.ndarray
    """Variance of the error by noise."""
    quadrature_bin: np.ndarray
    quadrature_bin2: np.ndarray
    """Mean square of the looks' quadratures by their power, over the number of looks."""


def robust(values: np.ndarray) -> float:
    """Standard deviation from the median distance from the median."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def scatter(speed_mps: float, snr: float, shots: int = 8000) -> tuple[float, float]:
    """Robust standard deviations of range and closing speed by least squares."""
    found = peaks(speed_mps, snr, shots)
    errors, _ = solve(found.error_bin, found.variance_bin2)
    return robust(errors[:, 0]) * RANGE_BIN_M, robust(errors[:, 1]) * SPEED_BIN_MPS


def solve(error_bin: np.ndarray, variance_bin2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors of beat and Doppler shift by weighted least squares, (shots, 2), and their variances."""
    weighted = np.swapaxes(_DESIGN / variance_bin2[..., None], 1, 2)
    normal = weighted @ _DESIGN
    solved = np.linalg.solve(normal, weighted @ error_bin[..., None])[..., 0]
    return solved, np.diagonal(np.linalg.inv(normal), axis1=1, axis2=2)


def peaks(speed_mps: float, snr: float, shots: int = 8000, looks: int = 1) -> Peaks:
    """Draw records and find their peaks, in sums over successive looks."""
    rng = np.random.default_rng(5)
    parts = _PARTS if looks == 1 else _PARTS // 4
    place = (np.arange(parts) + 0.5) / parts
    time_s = np.concatenate([record * SEGMENT_S + place * RECORD_S for record in range(-1, 3 * looks - 1)])
    power, modes = np.linalg.eigh(np.exp(-((speed_mps * (time_s[:, None] - time_s) / WAIST_M) ** 2)))
    kept = power > 1e-10 * power.max()
    field = _normal(rng, (shots, int(kept.sum()))) @ (modes[:, kept] * np.sqrt(power[kept])).T * np.sqrt(snr)
    field = field.reshape(shots * looks, 3, parts)
    found = Peaks(*np.empty((4, shots, 3)))
    for segment in range(3):
        light = field[:, segment]
        beside = np.repeat(rng.uniform(-0.5, 0.5, (shots, 1)), looks, axis=0)
        samples = light * np.exp(2j * np.pi * beside * place) + _normal(rng, light.shape) * np.sqrt(parts)
        offset, found.variance_bin2[:, segment], *quadrature = _peak(samples, place, looks)
        found.quadrature_bin[:, segment], found.quadrature_bin2[:, segment] = quadrature
        found.error_bin[:, segment] = offset - beside[::looks, 0]
    found.error_bin[:, 0] *= -1.0
    return found


def _normal(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Circular complex Gaussian numbers of unit power."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)


def _peak(samples: np.ndarray, place: np.ndarray, looks: int) -> tuple[np.ndarray, ...]:
    """Frequency of each peak in bins, its variance in noise of unit power per bin, its quadrature and the quadrature's
    mean square: of the sum over `looks` successive records."""
    near = np.arange(-3, 4)
    hamming = np.fft.fft(samples * (0.54 - 0.46 * np.cos(2.0 * np.pi * place)), axis=1)
    hann = np.fft.fft(samples * (0.5 - 0.5 * np.cos(2.0 * np.pi * place)), axis=1) / samples.shape[1]
    # From the beginning of the record instead of the middle of its first part.
    hann *= np.exp(-1j * np.pi * np.fft.fftfreq(samples.shape[1]))
    peak = near[(np.abs(hamming[:, near]) ** 2).reshape(-1, looks, len(near)).sum(axis=1).argmax(axis=1)]
    rows = np.arange(len(samples)).reshape(-1, looks)
    before, here, after = (hann[rows, peak[:, None] + step] for step in (-1, 0, 1))
    total = 2.0 * here + before + after
    power = (np.abs(total) ** 2).sum(axis=1)
    product = (before - after) * total.conj()
    ratio = product.sum(axis=1) / power
    squares = (product.imag**2 / np.abs(total) ** 2).sum(axis=1) / (looks * power)
    q = ratio.real
    offset = 4.0 * q / (3.0 + np.sqrt(9.0 + 16.0 * q * q))
    slope = 1.5 * (1.0 + offset**2) / (1.0 - offset**2) ** 2
    variance = (5.0 + 3.0 * q * q) / 16.0 / (power * slope**2)
    return peak + offset, np.clip(variance, 1e-12, 1.0 / 3.0), ratio.imag / slope, squares / slope**2

"""The published method to compute a spectrum, for comparison with the bins of `receiver.spectrum`.

Budge et al. deposit the beamlets' frequencies on an oversampled grid around the spectrum and convolve it with the
window's transform by a short FFT. Optimised for speed: the kernel's transform is computed once, many segments share one
call, and since only whole bins are needed, the products are folded before an inverse FFT that is shorter by the
oversampling.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, ifft

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.spectrum import SpectralWindow

Deposit = Literal["nearest", "cubic"]
"""A tone on the grid's nearest point, or on four by Lagrange's cubic."""

_ComplexArray = NDArray[np.complex128]


class PublishedSpectrum(NamedTuple):
    """A grid of `points`, `oversample` per bin, and the kernel's transform on it."""

    points: int
    oversample: int
    deposit: Deposit
    kernel: _ComplexArray

    @property
    def bins(self) -> int:
        """Number of whole bins in the output; tones must lie within half as many of each."""
        return self.points // self.oversample


def build_published_spectrum(
    window: SpectralWindow,
    length: float,
    points: int = 2048,
    oversample: int = 8,
    deposit: Deposit = "nearest",
) -> PublishedSpectrum:
    """Sample the transform of a window of `length` samples, referred to the record's centre, on a ring of points.

    A bin x bins above a tone holds sin(πx) / (N sin(πx/N)) of it, and the window adds its neighbours, which alternate
    in sign and are turned by exp(±jπ/N).
    """
    offset = np.fft.fftfreq(points, 1.0 / points) / oversample
    sides = _dirichlet(offset - 1.0, length) + _dirichlet(offset + 1.0, length)
    tilt = np.sin(np.pi / length) * (_dirichlet(offset + 1.0, length) - _dirichlet(offset - 1.0, length))
    kernel = window.centre * _dirichlet(offset, length) - window.side * (
        np.cos(np.pi / length) * sides + 1j * tilt
    )
    return PublishedSpectrum(points, oversample, deposit, np.asarray(fft(kernel)))


def _dirichlet(offset: FloatArray, length: float) -> FloatArray:
    return np.sinc(offset) / np.sinc(offset / length)


def published_bins(spectrum: PublishedSpectrum, tones: FloatArray, first_bin: FloatArray) -> _ComplexArray:
    """Windowed bins of segments, in the scale and with the phases of `receiver.spectrum`; images are left out.

    Args:
        spectrum: the grid.
        tones: (segments, 4, tones) n, δ, real and imaginary part of the weight.
        first_bin: (segments,) the lowest bin; all tones lie between it and `spectrum.bins` further on, and three grid
            points from both.

    Returns:
        (segments, bins).
    """
    grid = np.zeros((len(tones), spectrum.points), dtype=complex)
    _deposit(tones, first_bin, float(spectrum.oversample), spectrum.deposit == "cubic", grid)
    turned = fft(grid, axis=1, overwrite_x=True)
    turned *= spectrum.kernel
    folded = turned.reshape(len(tones), spectrum.oversample, spectrum.bins).mean(axis=1)
    bins = np.asarray(ifft(folded, axis=1, overwrite_x=True))
    odd = (np.arange(spectrum.bins) + first_bin[:, None].astype(np.int64)) % 2 == 1
    return np.where(odd, -bins, bins)


@kernel(outermost=True)
def _deposit(tones: FloatArray, first_bin: FloatArray, oversample: float, cubic: bool, grid: Any) -> None:
    for s in range(tones.shape[0]):
        for i in range(tones.shape[2]):
            place = ((tones[s, 0, i] - first_bin[s]) + tones[s, 1, i]) * oversample
            weight = complex(tones[s, 2, i], tones[s, 3, i])
            if not cubic:
                grid[s, int(np.rint(place))] += weight
                continue
            left = int(np.floor(place))
            t = place - left
            grid[s, left - 1] -= weight * (t * (t - 1.0) * (t - 2.0) / 6.0)
            grid[s, left] += weight * ((t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0)
            grid[s, left + 1] -= weight * ((t + 1.0) * t * (t - 2.0) / 2.0)
            grid[s, left + 2] += weight * ((t + 1.0) * t * (t - 1.0) / 6.0)

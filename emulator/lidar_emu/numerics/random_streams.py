"""Random streams: every random number of the package, and its purpose.

Philox4x32-10 of Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC11. The key is the run's seed; the
counter consists of shot, beam, purpose and index.

A number that belongs to a shot is a function of seed, shot, beam and purpose (`philox`), so that any shot can be
computed alone and no effect changes the numbers of another. Kernels call `philox` themselves, with a purpose from here;
everything else has a `RandomStream`. Large arrays that are drawn once, for a run or a ground, come from a numpy
generator made by `generator`.
"""

from __future__ import annotations

from math import copysign, log, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST, sin_pi

_MULTIPLIER_0 = np.uint64(0xD2511F53)
_MULTIPLIER_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)
_LOW = np.uint64(0xFFFFFFFF)
_WORD = np.uint64(32)
_SHIFT_26 = np.uint64(26)
_SHIFT_16 = np.uint64(16)
_SHIFT_5 = np.uint64(5)
_SHIFT_6 = np.uint64(6)
_ONE = np.uint64(1)

_ROOT_HALF_BITS = int(np.float64(sqrt(0.5)).view(np.int64))
_LN_2 = log(2.0)

_Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]
_Key = tuple[np.uint64, np.uint64]


@kernel(forceinline=True)
def philox4x32(
    c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, k0: np.uint64, k1: np.uint64
) -> _Words:
    """Ten rounds of Philox: four random words from a counter of four words and a key of two.

    All words are below 2**32, held in uint64 since the products need that width.
    """
    # Unrolled: a loop over counters is vectorised only if it contains no loop.
    w, k = _round((c0, c1, c2, c3), (k0, k1))
    w, k = _round(w, k)
    w, k = _round(w, k)
    w, k = _round(w, k)
    w, k = _round(w, k)
    w, k = _round(w, k)
    w, k = _round(w, k)
    w, k = _round(w, k)
    w, k = _round(w, k)
    w, _ = _round(w, k)
    return w


@kernel(forceinline=True)
def _round(w: _Words, k: _Key) -> tuple[_Words, _Key]:
    left = _MULTIPLIER_0 * w[0]
    right = _MULTIPLIER_1 * w[2]
    words = (right >> _WORD) ^ w[1] ^ k[0], right & _LOW, (left >> _WORD) ^ w[3] ^ k[1], left & _LOW
    return words, ((k[0] + _WEYL_0) & _LOW, (k[1] + _WEYL_1) & _LOW)


@kernel
def uniform_pair(seed: np.uint64, shot: int, beam: int, purpose: int, index: int) -> tuple[float, float]:
    """Two independent uniforms, strictly between 0 and 1, of 53 bits each.

    `beam` and `purpose` are below 2**16, `index` below 2**32; `seed` and `shot` are 64 bits wide.
    """
    number = np.uint64(shot)
    a, b, c, d = philox4x32(
        number & _LOW,
        number >> _WORD,
        (np.uint64(purpose) << _SHIFT_16) | np.uint64(beam),
        np.uint64(index),
        seed & _LOW,
        seed >> _WORD,
    )
    return _unit_interval(a, b), _unit_interval(c, d)


@kernel
def complex_normal(seed: np.uint64, shot: int, beam: int, purpose: int, index: int) -> tuple[float, float]:
    """Real and imaginary part of a circular complex Gaussian of unit mean power (Box-Muller)."""
    u, turn = uniform_pair(seed, shot, beam, purpose, index)
    radius = sqrt(-log(u))
    cosine, sine = unit_phasor(turn)
    return radius * cosine, radius * sine


@kernel
def fill_complex_normals(
    seed: np.uint64,
    shot: int,
    beam: int,
    purpose: int,
    first_pair: int,
    count: int,
    words: NDArray[np.uint64],
    out: FloatArray,
) -> None:
    """Fill the first `count` columns, an even number, of `out` with circular complex Gaussians of unit mean power.

    Numbers 2i and 2i + 1 come from counter `first_pair` + i (Box-Muller): 32 bits each for magnitude and phase, so that
    no power exceeds 22.9, which has a probability of 1e-10. `words` (4, count/2 or more) is overwritten. The stages
    have no branches, so that they are vectorised.
    """
    use = (np.uint64(purpose) << _SHIFT_16) | np.uint64(beam)
    _fill_words(seed, np.uint64(shot), use, np.uint64(first_pair), _ONE, count // 2, words, int(np.int64(0)))
    _to_normals(words, out[0, :count], out[1, :count])


@kernel
def fill_normals_of_shots(
    seed: np.uint64,
    shots: NDArray[np.int64],
    beam: int,
    purpose: int,
    count: int,
    words: NDArray[np.uint64],
    re: FloatArray,
    im: FloatArray,
) -> None:
    """Fill `re` and `im`, each (shots * count,), with the first `count` numbers of each shot of `fill_complex_normals`,
    whose few numbers a shot would take vectors of their own."""
    use = (np.uint64(purpose) << _SHIFT_16) | np.uint64(beam)
    for s in range(len(shots)):
        _fill_words(seed, np.uint64(shots[s]), use, np.uint64(0), _ONE, count // 2, words, s * count // 2)
    _to_normals(words, re, im)


@kernel
def fill_spaced_normals(
    seed: np.uint64,
    shot: int,
    beam: int,
    purpose: int,
    first: int,
    step: int,
    count: int,
    words: NDArray[np.uint64],
    out: FloatArray,
) -> None:
    """Fill the first `count` columns of `out` with the numbers of `complex_normal` with the indices `first`,
    `first` + `step` and so on, faster than one by one. `words` (4, count or more) is overwritten."""
    use = (np.uint64(purpose) << _SHIFT_16) | np.uint64(beam)
    _fill_words(seed, np.uint64(shot), use, np.uint64(first), np.uint64(step), count, words, int(np.int64(0)))
    words_0, words_1, words_2, words_3 = words[0], words[1], words[2], words[3]
    re, im = out[0], out[1]
    for i in range(count):
        re[i], im[i] = _unit_interval(words_0[i], words_1[i]), _unit_interval(words_2[i], words_3[i])
    for i in range(count):
        re[i] = -log(re[i])
    for i in range(count):
        radius = sqrt(re[i])
        cosine, sine = unit_phasor(im[i])
        re[i], im[i] = radius * cosine, radius * sine


@kernel
def _fill_words(
    seed: np.uint64,
    number: np.uint64,
    use: np.uint64,
    first: np.uint64,
    step: np.uint64,
    count: int,
    words: NDArray[np.uint64],
    column: int,
) -> None:
    k0, k1 = seed & _LOW, seed >> _WORD
    low, high = number & _LOW, number >> _WORD
    # Rows are selected before the loops: selection within a loop prevents vectorisation.
    words_0, words_1 = words[0, column:], words[1, column:]
    words_2, words_3 = words[2, column:], words[3, column:]
    for i in range(count):
        a, b, c, d = philox4x32(low, high, use, (first + step * np.uint64(i)) & _LOW, k0, k1)
        words_0[i], words_1[i], words_2[i], words_3[i] = a, b, c, d


@kernel
def _to_normals(words: NDArray[np.uint64], re: FloatArray, im: FloatArray) -> None:
    _set_uniforms(words[0], words[2], re)
    _set_uniforms(words[1], words[3], im)
    _box_muller(re, im)


@kernel
def _set_uniforms(even: NDArray[np.uint64], odd: NDArray[np.uint64], out: FloatArray) -> None:
    for i in range(len(out) // 2):
        out[2 * i] = (np.float64(np.int64(even[i])) + 0.5) * 2.0**-32
        out[2 * i + 1] = (np.float64(np.int64(odd[i])) + 0.5) * 2.0**-32


@kernel(fastmath=FAST)
def _box_muller(re: FloatArray, im: FloatArray) -> None:
    bits = re.view(np.int64)
    for i in range(len(re)):
        # The exponent counts from sqrt(1/2), so that the mantissa is close to 1.
        exponent = (bits[i] - _ROOT_HALF_BITS) >> 52
        bits[i] -= exponent << 52
        radius = sqrt(-(exponent * _LN_2 + _ln_near_one(re[i])))
        cosine, sine = unit_phasor(im[i])
        re[i], im[i] = radius * cosine, radius * sine


@kernel(fastmath=FAST, forceinline=True)
def _ln_near_one(x: float) -> float:
    """ln x for x from sqrt(1/2) to sqrt(2), relative error 2e-16: 2 artanh s with s = (x - 1)/(x + 1)."""
    s = (x - 1.0) / (x + 1.0)
    y = s * s
    series = 1 / 13 + y * (1 / 15 + y * (1 / 17 + y * (1 / 19 + y / 21)))
    series = 1.0 + y * (1 / 3 + y * (1 / 5 + y * (1 / 7 + y * (1 / 9 + y * (1 / 11 + y * series)))))
    return 2.0 * s * series


@kernel(fastmath=FAST, forceinline=True)
def unit_phasor(turn: float) -> tuple[float, float]:
    """Cosine and sine of 2 pi `turn` - pi, for `turn` from 0 to 1."""
    x = 2.0 * turn - 1.0
    return sin_pi(0.5 - abs(x)), sin_pi(copysign(min(abs(x), 1.0 - abs(x)), x))


@kernel(forceinline=True)
def _unit_interval(high: np.uint64, low: np.uint64) -> float:
    bits = ((high >> _SHIFT_5) << _SHIFT_26) | (low >> _SHIFT_6)
    return (np.float64(bits) + 0.5) * 2.0**-53


_RECEIVER: Any = np.arange(1, 7)
PHASE, NOISE_BINS, SPECKLE, LINE, HAZE, FALSE_ALARM = _RECEIVER
"""Purposes in the receiver's kernels. They are variables: numba would compile a kernel again for each literal."""
FIRST_FAULT = 1024
"""Purpose of the first fault in a scenario's list; the others follow."""
DUST = 5120
"""Purpose of the dust raised by the plume."""
SCATTERERS = 5122
"""Purpose of a measurement's scatterers, noise and laser phase, as a key of `generator`."""
SWEEP: Any = np.int64(5123)
"""Purpose of the errors of the laser's sweep; also a key of `generator`."""
BACK_REFLECTION: Any = np.int64(5124)
"""Purpose of the phase of light that the optics reflect."""
RIPPLE: Any = np.int64(5125)
"""Purpose of the phase of the chirps' periodic non-linearity; also a key of `generator`."""
STREAK: Any = np.int64(5126)
"""Purpose of the speckle of a streak of dust."""
INERTIAL = 5127
"""Purpose of the errors of an inertial unit, as a key of `generator`."""
COMPARED_RAYS = 5128
"""Purpose of the rays that are cast by two programs, as a key of `generator`."""

RELIEF, CRATERS, ROCKS = range(3)
"""Keys of `generator`, after the seed of a generated ground."""
SHARES, RUN_SEEDS = range(2)
"""Keys of `generator`, after the seed of a campaign: quantiles of the dispersed keys, and the seeds of its runs."""

WHOLE_SHOT = 0xFFFF
"""Placeholder for the number of a beam."""


def fault_purpose(number: int) -> int:
    """Purpose of a fault by its index in the scenario's list.

    Raises:
        ValueError: the purposes of faults are used up.
    """
    if not 0 <= number < DUST - FIRST_FAULT:
        raise ValueError(f"fault {number}; must be fewer than {DUST - FIRST_FAULT}")
    return FIRST_FAULT + number


def generator(
    *key: int, bit_generator: type[np.random.BitGenerator] = np.random.Philox
) -> np.random.Generator:
    """A numpy generator for arrays drawn as a whole.

    Args:
        key: seed and further natural numbers; another key gives an independent stream.
        bit_generator: Philox, unless published results depend on another one.
    """
    return np.random.Generator(bit_generator(np.random.SeedSequence(key)))


class RandomStream:
    """Random numbers of one purpose by shot and beam, such as the numbers of one fault.

    Args:
        seed: the run's seed.
        purpose: declared in this module.
    """

    def __init__(self, seed: int, purpose: int) -> None:
        self._seed = np.uint64(seed)
        self._purpose = purpose
        # Kernels are compiled before the run, so that the first shot with a fault is not late.
        no_shot = np.empty(0, dtype=np.int64)
        self.uniforms(no_shot, 1, 0)
        self.normals(no_shot, 1, 0)
        self.per_shot(no_shot)
        self.sequence(0, 0, 0)

    def uniforms(self, shot: NDArray[np.int64], beams: int, index: int) -> FloatArray:
        """Uniforms (shots, beams, 2) between 0 and 1; another `index` gives other numbers."""
        out = np.empty((len(shot), beams, 2))
        _fill_uniforms(self._seed, shot, self._purpose, index, out)
        return out

    def normals(self, shot: NDArray[np.int64], beams: int, index: int) -> FloatArray:
        """Standard normal numbers (shots, beams, 2); another `index` gives other numbers."""
        out = np.empty((len(shot), beams, 2))
        _fill_normals(self._seed, shot, self._purpose, index, out)
        return out

    def per_shot(self, shot: NDArray[np.int64]) -> FloatArray:
        """One uniform (shots,) per shot as a whole."""
        out = np.empty(len(shot))
        _fill_per_shot(self._seed, shot, self._purpose, out)
        return out

    def sequence(self, shot: int, first: int, count: int) -> FloatArray:
        """Uniforms (count,) from number `first` on, of a further sequence per shot."""
        out = np.empty(count)
        _fill_sequence(self._seed, shot, self._purpose, first, out)
        return out


@kernel(outermost=True)
def _fill_uniforms(
    seed: np.uint64, shot: NDArray[np.int64], purpose: int, index: int, out: FloatArray
) -> None:
    for s in range(len(shot)):
        for b in range(out.shape[1]):
            out[s, b, 0], out[s, b, 1] = uniform_pair(seed, shot[s], b, purpose, index)


@kernel(outermost=True)
def _fill_normals(
    seed: np.uint64, shot: NDArray[np.int64], purpose: int, index: int, out: FloatArray
) -> None:
    for s in range(len(shot)):
        for b in range(out.shape[1]):
            x, y = complex_normal(seed, shot[s], b, purpose, index)
            out[s, b, 0], out[s, b, 1] = x * np.sqrt(2.0), y * np.sqrt(2.0)


@kernel(outermost=True)
def _fill_per_shot(seed: np.uint64, shot: NDArray[np.int64], purpose: int, out: FloatArray) -> None:
    for s in range(len(shot)):
        out[s], _ = uniform_pair(seed, shot[s], WHOLE_SHOT, purpose, 0)


@kernel(outermost=True)
def _fill_sequence(seed: np.uint64, shot: int, purpose: int, first: int, out: FloatArray) -> None:
    for k in range(len(out)):
        out[k], _ = uniform_pair(seed, shot, WHOLE_SHOT, purpose, 1 + first + k)

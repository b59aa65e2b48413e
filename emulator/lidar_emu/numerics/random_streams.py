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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST, sin_pi, single_sin_pi

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

_ROOT_HALF_BITS = np.float32(sqrt(0.5)).view(np.int32)
_ZERO, _HALF, _UNIT, _LN_2 = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(log(2.0))
_PER_31_BITS, _PER_32_BITS = np.float32(2.0**-31), np.float32(2.0**-32)
_L0, _L1, _L2 = np.float32(7.0376836292e-2), np.float32(-1.1514610310e-1), np.float32(1.1676998740e-1)
_L3, _L4, _L5 = np.float32(-1.2420140846e-1), np.float32(1.4249322787e-1), np.float32(-1.6668057665e-1)
_L6, _L7, _L8 = np.float32(2.0000714765e-1), np.float32(-2.4999993993e-1), np.float32(3.3333331174e-1)

_Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]
_Key = tuple[np.uint64, np.uint64]


@kernel
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


@kernel
def _round(w: _Words, k: _Key) -> tuple[_Words, _Key]:
    left = _MULTIPLIER_0 * w[0]
    right = _MULTIPLIER_1 * w[2]
    words = (right >> _WORD) ^ w[1] ^ k[0], right & _LOW, (left >> _WORD) ^ w[3] ^ k[1], left & _LOW
    return words, ((k[0] + _WEYL_0) & _LOW, (k[1] + _WEYL_1) & _LOW)


@kernel(forceinline=False)
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


class Normals(NamedTuple):
    """Room for circular complex Gaussians of unit mean power, in single precision: see `draw_words`, `set_normals`."""

    re: SingleArray
    im: SingleArray
    """(numbers,) Real and imaginary parts."""
    words: NDArray[np.int32]
    """(4, numbers / 2) Random words, overwritten."""
    exponents: NDArray[np.int32]
    """(numbers,) Overwritten."""
    counters: NDArray[np.uint64]
    """(2, numbers / 2) Purpose with beam, and counter of each pair of numbers; see `reserve_numbers`."""


_AT_ONCE = 16
"""Numbers are drawn in multiples of it: what is left of a loop over vectors takes as long as the vectors."""


def normals(numbers: int) -> Normals:
    """Allocate room for up to `numbers` numbers."""
    numbers += _AT_ONCE + numbers % 2
    return Normals(
        re=np.zeros(numbers, dtype=np.float32),
        im=np.zeros(numbers, dtype=np.float32),
        words=np.zeros((4, numbers // 2), dtype=np.int32),
        exponents=np.zeros(numbers, dtype=np.int32),
        counters=np.zeros((2, numbers // 2), dtype=np.uint64),
    )


@kernel(forceinline=False)
def draw_words(
    seed: np.uint64,
    shot: int,
    beam: int,
    purpose: int,
    first: int,
    numbers: int,
    at: int,
    words: NDArray[np.int32],
) -> int:
    """Draw the words of numbers `first`, even, to `first` + `numbers` - 1 of a purpose into columns `at`, even, and on,
    and overwrite up to 15 columns behind.

    Numbers 2i and 2i + 1 come from counter i. `set_normals` makes numbers of the words, of all purposes at once: short
    loops cost more than what they compute.

    Returns:
        The column behind the last pair.
    """
    use = (np.uint64(purpose) << _SHIFT_16) | np.uint64(beam)
    number, column = np.uint64(shot), at // 2
    k0, k1 = seed & _LOW, seed >> _WORD
    low, high, counter = number & _LOW, number >> _WORD, np.uint64(first // 2)
    # Rows are selected before the loop: selection within it prevents vectorisation.
    words_0, words_1 = words[0, column:], words[1, column:]
    words_2, words_3 = words[2, column:], words[3, column:]
    for i in range(-(-numbers // _AT_ONCE) * (_AT_ONCE // 2)):
        a, b, c, d = philox4x32(low, high, use, (counter + np.uint64(i)) & _LOW, k0, k1)
        # 31 bits for a magnitude, which is never negative.
        words_0[i], words_1[i] = np.int32(a >> _ONE), np.int32(b)
        words_2[i], words_3[i] = np.int32(c >> _ONE), np.int32(d)
    return at + numbers + numbers % 2


@kernel
def reserve_numbers(beam: int, purpose: int, first: int, numbers: int, at: int, into: Normals) -> int:
    """Reserve columns `at`, even, and on for numbers `first`, even, to `first` + `numbers` - 1 of a purpose, which
    `draw_reserved` draws together with others.

    Returns:
        The column behind the last pair.
    """
    use, counter, column = (np.uint64(purpose) << _SHIFT_16) | np.uint64(beam), np.uint64(first // 2), at // 2
    uses, counters = into.counters[0, column:], into.counters[1, column:]
    for i in range((numbers + 1) // 2):
        uses[i], counters[i] = use, counter + np.uint64(i)
    return at + numbers + numbers % 2


@kernel(forceinline=False)
def draw_reserved(
    seed: np.uint64, shot: int, count: int, counters: NDArray[np.uint64], words: NDArray[np.int32]
) -> None:
    """Draw the words of the first `count` numbers as they are reserved."""
    number, k0, k1 = np.uint64(shot), seed & _LOW, seed >> _WORD
    low, high = number & _LOW, number >> _WORD
    uses, indices = counters[0], counters[1]
    words_0, words_1, words_2, words_3 = words[0], words[1], words[2], words[3]
    for i in range(-(-count // _AT_ONCE) * (_AT_ONCE // 2)):
        a, b, c, d = philox4x32(low, high, uses[i], indices[i] & _LOW, k0, k1)
        words_0[i], words_1[i] = np.int32(a >> _ONE), np.int32(b)
        words_2[i], words_3[i] = np.int32(c >> _ONE), np.int32(d)


@kernel(fastmath=FAST, forceinline=False)
def set_normals(count: int, into: Normals) -> None:
    """Set the first `count` numbers, an even one, from their words (Box-Muller): 31 bits for magnitude, 32 for phase,
    so that no power exceeds 22.2, which has a probability of 2e-10.

    The stages have no branches, so that they are vectorised, and the relative error is 2e-7.
    """
    re, im, exponent = into.re, into.im, into.exponents
    words_0, words_1, words_2, words_3 = into.words[0], into.words[1], into.words[2], into.words[3]
    count = -(-count // _AT_ONCE) * _AT_ONCE
    for i in range(count // 2):
        re[2 * i] = (np.float32(words_0[i]) + _HALF) * _PER_31_BITS
        re[2 * i + 1] = (np.float32(words_2[i]) + _HALF) * _PER_31_BITS
        im[2 * i] = np.float32(words_1[i]) * _PER_32_BITS
        im[2 * i + 1] = np.float32(words_3[i]) * _PER_32_BITS
    bits = re.view(np.int32)
    # The exponent counts from sqrt(1/2), so that the mantissa is close to 1. Stored, each stays a word of 32 bits.
    for i in range(count):
        exponent[i] = (bits[i] - _ROOT_HALF_BITS) >> 23
    for i in range(count):
        bits[i] = bits[i] - (exponent[i] << 23)
    for i in range(count):
        radius = np.sqrt(max(-_ln_near_one(re[i]) - np.float32(exponent[i]) * _LN_2, _ZERO))
        cosine, sine = single_phasor(im[i])
        re[i], im[i] = radius * cosine, radius * sine


@kernel(fastmath=FAST)
def _ln_near_one(x: np.float32) -> np.float32:
    """ln x for x from sqrt(1/2) to sqrt(2), error 1e-7 (polynomial of Moshier's Cephes library)."""
    y = x - _UNIT
    z = y * y
    p = _L0
    p = p * y + _L1
    p = p * y + _L2
    p = p * y + _L3
    p = p * y + _L4
    p = p * y + _L5
    p = p * y + _L6
    p = p * y + _L7
    p = p * y + _L8
    return y + (y * z * p - _HALF * z)


@kernel(fastmath=FAST)
def single_phasor(turn: np.float32) -> tuple[np.float32, np.float32]:
    """Cosine and sine of 2 pi `turn`, for `turn` from -1/2 to 1/2, error 1e-7."""
    x = turn + turn
    beyond = abs(x)
    return single_sin_pi(_HALF - beyond), single_sin_pi(np.copysign(min(beyond, _UNIT - beyond), x))


@kernel(fastmath=FAST)
def unit_phasor(turn: float) -> tuple[float, float]:
    """Cosine and sine of 2 pi `turn` - pi, for `turn` from 0 to 1."""
    x = 2.0 * turn - 1.0
    return sin_pi(0.5 - abs(x)), sin_pi(copysign(min(abs(x), 1.0 - abs(x)), x))


@kernel
def _unit_interval(high: np.uint64, low: np.uint64) -> float:
    bits = ((high >> _SHIFT_5) << _SHIFT_26) | (low >> _SHIFT_6)
    return (np.float64(bits) + 0.5) * 2.0**-53


_RECEIVER: Any = np.arange(1, 9)
PHASE, NOISE_BINS, SPECKLE, LINE, HAZE, FALSE_ALARM, PATH, WAVES = _RECEIVER
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
VIBRATION = 5129
"""Purpose of the tones of the vehicle's vibration, as a key of `generator`."""

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

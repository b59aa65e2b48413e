"""Counter-based chance against the published vectors and the distributions it claims."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from lidar_emu.numerics.random_streams import (
    complex_normal,
    draw_reserved,
    draw_words,
    normals,
    philox4x32,
    reserve_numbers,
    set_normals,
    uniform_pair,
)


# Known answers published with the Random123 library: counter, key, result.
@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_known_answers(counter: tuple[int, ...], key: tuple[int, ...], expected: tuple[int, ...]) -> None:
    assert philox4x32(*map(np.uint64, counter), *map(np.uint64, key)) == expected


def _normals(seed: np.uint64, count: int, along: str) -> np.ndarray:
    """Complex normals along one part of the counter."""
    fixed = {"shot": 3, "beam": 5, "purpose": 2, "index": 7}
    return np.array([complex(*complex_normal(seed, *(fixed | {along: i}).values())) for i in range(count)])


@pytest.mark.parametrize("along", ["shot", "beam", "index"])
def test_normals_are_normal_and_independent_along_each_part_of_the_counter(along: str) -> None:
    z = _normals(np.uint64(11), 60_000, along)
    for part in (z.real, z.imag):
        assert stats.kstest(part * np.sqrt(2), "norm").pvalue > 1e-3
    bound = 4 / np.sqrt(len(z))
    assert abs(np.mean(z**2)) < bound * np.sqrt(2)
    assert abs(np.mean(z[1:] * np.conj(z[:-1]))) < bound
    assert abs(np.mean(abs(z) ** 2) - 1) < bound


def test_uniforms_fill_the_open_interval() -> None:
    pairs = np.array([uniform_pair(np.uint64(1), 0, 0, 1, i) for i in range(20_000)])
    assert pairs.min() > 0
    assert pairs.max() < 1
    for column in pairs.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / np.sqrt(len(pairs))


def test_every_part_of_the_key_and_the_counter_counts() -> None:
    base = (np.uint64(9), 1, 2, 3, 4)
    others = [
        (np.uint64(9 + 2**32), 1, 2, 3, 4),
        (np.uint64(10), 1, 2, 3, 4),
        (np.uint64(9), 1 + 2**32, 2, 3, 4),
        (np.uint64(9), 2, 2, 3, 4),
        (np.uint64(9), 1, 3, 3, 4),
        (np.uint64(9), 1, 2, 4, 4),
        (np.uint64(9), 1, 2, 3, 5),
    ]
    drawn = {uniform_pair(*counter) for counter in [base, *others]}
    assert len(drawn) == len(others) + 1


def _drawn(first: int, count: int, shot: int = 3) -> np.ndarray:
    """Numbers `first` and on of one purpose."""
    drawn = normals(count)
    draw_words(np.uint64(2**40 + 11), shot, 5, 2, first, count, 0, drawn.words)
    set_normals(count, drawn)
    return (drawn.re + 1j * drawn.im.astype(float))[:count]


@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 46, 64])
def test_numbers_drawn_are_box_muller_of_the_words(count: int) -> None:
    """Two of each counter, from 31 bits for the magnitude and 32 for the phase, in single precision."""
    shot, seed = 2**33 + 3, 2**40 + 11
    drawn = _drawn(14, count, shot)
    for i, z in enumerate(drawn):
        counter = (shot % 2**32, shot >> 32, (2 << 16) | 5, 7 + i // 2)
        words = philox4x32(*map(np.uint64, counter), np.uint64(seed % 2**32), np.uint64(seed >> 32))
        magnitude, phase = (int(word) for word in words[2 * (i % 2) : 2 * (i % 2) + 2])
        turn = (phase - 2**32 if phase >= 2**31 else phase) / 2**32
        exact = np.sqrt(-np.log((magnitude // 2 + 0.5) / 2**31)) * np.exp(2j * np.pi * turn)
        # Close to 1 the uniform number is rounded by 3e-8, and so is the power.
        assert abs(z - exact) < 5e-7 * abs(exact) + 4e-8 / max(abs(exact), 1e-4)


def test_numbers_do_not_depend_on_those_drawn_with_them() -> None:
    whole = _drawn(0, 200)
    for first, count in ((0, 3), (10, 40), (64, 16), (198, 2)):
        np.testing.assert_array_equal(_drawn(first, count), whole[first : first + count])


def test_numbers_reserved_are_those_drawn_one_purpose_after_the_other() -> None:
    drawn = normals(150)
    at = reserve_numbers(5, 2, 14, 37, 0, drawn)
    assert at == 38
    at = reserve_numbers(7, 3, 0, 80, at, drawn)
    draw_reserved(np.uint64(2**40 + 11), 3, at, drawn.counters, drawn.words)
    set_normals(at, drawn)
    np.testing.assert_array_equal((drawn.re + 1j * drawn.im.astype(float))[:37], _drawn(14, 37))
    other = normals(80)
    draw_words(np.uint64(2**40 + 11), 3, 7, 3, 0, 80, 0, other.words)
    set_normals(80, other)
    np.testing.assert_array_equal(drawn.re[38:118], other.re[:80])


@pytest.mark.slow
def test_numbers_drawn_are_circular_gaussians() -> None:
    z = np.concatenate([_drawn(0, 400, shot) for shot in range(500)])
    assert stats.kstest(abs(z) ** 2, "expon").pvalue > 1e-3
    assert stats.kstest(np.angle(z) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    bound = 4 / np.sqrt(len(z))
    assert abs(np.mean(z**2)) < bound * np.sqrt(2)
    assert abs(np.mean(z[1:] * np.conj(z[:-1]))) < bound
    assert abs(np.mean(abs(z) ** 2) - 1) < bound


def test_extreme_words_give_finite_numbers() -> None:
    drawn = normals(16)
    drawn.words[0], drawn.words[2] = 0, 2**31 - 1
    drawn.words[1], drawn.words[3] = -(2**31), 2**31 - 1
    set_normals(16, drawn)
    power = drawn.re**2 + drawn.im**2
    assert power[0] == pytest.approx(np.log(2.0**32), rel=1e-6)
    assert (power[1::2] < 1e-7).all()
    assert np.isfinite(power).all()

"""Counter-based chance against the published vectors and the distributions it claims."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from lidar_emu.numerics.random_streams import (
    complex_normal,
    fill_complex_normals,
    fill_spaced_normals,
    philox4x32,
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


def _filled(first_pair: int, count: int, shot: int = 3) -> np.ndarray:
    out = np.empty((2, count))
    words = np.empty((4, count // 2), dtype=np.uint64)
    fill_complex_normals(np.uint64(2**40 + 11), shot, 5, 2, first_pair, count, words, out)
    return out[0] + 1j * out[1]


def test_spaced_normals_are_those_drawn_one_by_one() -> None:
    """To the bit: to draw them together is quicker, and nothing else."""
    shot, seed, first, step, count = 2**33 + 3, np.uint64(2**63 + 11), 2**24 - 5, 2, 37
    out, words = np.empty((2, count)), np.empty((4, count), dtype=np.uint64)
    fill_spaced_normals(seed, shot, 5, 2, first, step, count, words, out)
    for i in range(count):
        assert complex_normal(seed, shot, 5, 2, first + step * i) == (out[0, i], out[1, i])


@pytest.mark.slow
def test_filled_normals_are_box_muller_of_the_words() -> None:
    """Two numbers of each counter, from 32 bits each for magnitude and phase."""
    shot, seed = 2**33 + 3, 2**40 + 11
    for i, pair in enumerate(_filled(7, 64, shot).reshape(-1, 2)):
        counter = (shot % 2**32, shot >> 32, (2 << 16) | 5, 7 + i)
        words = philox4x32(*map(np.uint64, counter), np.uint64(seed % 2**32), np.uint64(seed >> 32))
        a, b, c, d = ((int(w) + 0.5) / 2**32 for w in words)
        for z, u, turn in ((pair[0], a, b), (pair[1], c, d)):
            assert z == pytest.approx(np.sqrt(-np.log(u)) * np.exp(2j * np.pi * turn - 1j * np.pi), rel=1e-13)

"""Counter-based chance against the published vectors and the distributions it claims."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from lidar_emu.fmcw.philox import complex_normal, philox4x32, uniform_pair


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

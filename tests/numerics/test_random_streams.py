"""Random streams: purposes that cannot collide, keys, and no other source of random numbers in the package."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import lidar_emu
from lidar_emu.numerics.random_streams import (
    DUST,
    FALSE_ALARM,
    FIRST_FAULT,
    HAZE,
    LINE,
    NOISE_BINS,
    PHASE,
    SPECKLE,
    RandomStream,
    fault_purpose,
    generator,
    uniform_pair,
)

PACKAGE = Path(lidar_emu.__file__).parent


def test_purposes_differ_and_fit_into_their_bits() -> None:
    receiver = [PHASE, NOISE_BINS, SPECKLE, LINE, HAZE, FALSE_ALARM]
    faults = [fault_purpose(number) for number in (0, 1, 4095)]
    every = [int(purpose) for purpose in [*receiver, *faults, DUST]]
    assert len(set(every)) == len(every)
    assert max(receiver) < FIRST_FAULT
    assert max(every) < 2**16


@pytest.mark.parametrize("number", [-1, 4096])
def test_no_fault_takes_another_purpose(number: int) -> None:
    with pytest.raises(ValueError, match=r"fault .*; must be fewer than 4096"):
        fault_purpose(number)


def test_a_stream_is_philox_at_its_purpose() -> None:
    stream, shot = RandomStream(2**40 + 5, DUST), np.array([3, 2**33])
    drawn = stream.uniforms(shot, 2, 7)
    for s, number in enumerate(shot):
        for beam in range(2):
            alone = uniform_pair(np.uint64(2**40 + 5), number, beam, DUST, 7)
            assert tuple(drawn[s, beam]) == alone
    whole = uniform_pair(np.uint64(2**40 + 5), 3, 0xFFFF, DUST, 0)
    assert stream.per_shot(shot)[0] == whole[0]


def test_generators_of_other_keys_differ_and_those_of_the_same_key_agree() -> None:
    keys = [(1,), (1, 0), (1, 1), (2, 0), (1, 0, 1)]
    # A sequence of seeds ends in implied zeros: (1,) and (1, 0) are the same entropy.
    drawn = {tuple(generator(*key).random(4)) for key in keys}
    assert len(drawn) == len(keys) - 1
    assert generator(1, 2).random() == generator(1, 2).random()


def test_random_numbers_come_from_nowhere_else() -> None:
    makers = re.compile(
        r"default_rng|SeedSequence|RandomState|np\.random\.(rand|seed)|os\.urandom|^(import|from) random\b",
        re.M,
    )
    found = [
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if makers.search(path.read_text(encoding="utf-8"))
    ]
    benches = [name for name in found if name.startswith("bench/")]
    assert sorted(set(found) - set(benches)) == ["numerics/random_streams.py"]

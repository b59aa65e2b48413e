"""When faults act, against the definition worked out for one shot at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.faults.schedule import FaultSchedule
from lidar_emu.numerics.random_streams import RandomStream, fault_purpose
from lidar_emu.scenario.faults.beams import Dropout

PERIOD_NS = 20_000_000


def schedule(number: int = 0, seed: int = 1, **when: object) -> FaultSchedule:
    fault = Dropout.model_validate({"kind": "dropout", **when})
    return FaultSchedule(fault, RandomStream(seed, fault_purpose(number)), PERIOD_NS)


def shots(first: int, count: int) -> np.ndarray:
    return np.arange(first, first + count, dtype=np.int64)


@pytest.mark.parametrize(
    ("when", "expected"),
    [
        ({}, range(100)),
        ({"at_s": 0.0}, [0]),
        ({"at_s": 0.2}, [10]),
        ({"at_s": 0.201}, [11]),
        ({"from_s": 0.2, "to_s": 0.3}, range(10, 15)),
        ({"from_s": 0.201, "to_s": 0.299}, range(11, 15)),
        ({"from_s": 1.9}, range(95, 100)),
        ({"from_s": 0.301, "to_s": 0.302}, []),
    ],
)
def test_windows(when: dict[str, float], expected: object) -> None:
    assert np.flatnonzero(schedule(**when).active_shots(shots(0, 100))).tolist() == list(expected)  # type: ignore[call-overload]


def test_a_time_after_many_shots_is_resolved_to_the_nanosecond() -> None:
    assert schedule(from_s=2000.0).active_shots(shots(99_999, 3)).tolist() == [False, True, True]
    assert schedule(from_s=2000.0 + 1e-9).active_shots(shots(99_999, 3)).tolist() == [False, False, True]


@given(
    first=st.integers(0, 60),
    count=st.integers(1, 60),
    from_s=st.floats(0, 1),
    length_s=st.floats(0.01, 2),
    probability=st.floats(0.01, 0.99),
    lasts_s=st.floats(0, 0.5),
    seed=st.integers(0, 2**63 - 1),
)
@settings(deadline=None, max_examples=60)
def test_onsets_in_any_block_are_those_of_each_shot_alone(
    first: int, count: int, from_s: float, length_s: float, probability: float, lasts_s: float, seed: int
) -> None:
    to_s = from_s + length_s
    asked = schedule(3, seed, from_s=from_s, to_s=to_s, probability=probability, lasts_s=lasts_s)
    stream = RandomStream(seed, fault_purpose(3))
    lasts = max(1, -(-round(lasts_s * 1e9) // PERIOD_NS))

    def inside(shot: int) -> bool:
        return round(from_s * 1e9) <= shot * PERIOD_NS < round(to_s * 1e9)

    def sets_in(shot: int, beam: int) -> bool:
        return inside(shot) and stream.uniforms(shots(shot, 1), 3, 0)[0, beam, 0] < probability

    acts = asked.active_beams(shots(first, count), 3)
    for row, shot in enumerate(range(first, first + count)):
        for beam in range(3):
            hit = any(sets_in(k, beam) for k in range(max(0, shot - lasts + 1), shot + 1))
            assert acts[row, beam] == (inside(shot) and hit)


def test_faults_beams_and_seeds_have_random_streams_of_their_own() -> None:
    many = shots(0, 20_000)
    first = schedule(0, probability=0.1).active_beams(many, 2)
    others = (
        schedule(1, probability=0.1).active_beams(many, 2),
        schedule(0, 2, probability=0.1).active_beams(many, 2),
    )
    for acts in (first, *others):
        # Five sigma of a binomial count.
        np.testing.assert_allclose(acts.mean(axis=0), 0.1, atol=5 * np.sqrt(0.09 / len(many)))
    for one, other in ((first[:, 0], first[:, 1]), *((first[:, 0], acts[:, 0]) for acts in others)):
        assert (one & other).mean() == pytest.approx(0.01, abs=5 * np.sqrt(0.01 / len(many)))


def test_numbers_of_a_whole_shot_differ_from_those_of_its_beams() -> None:
    many = shots(0, 1000)
    stream = RandomStream(1, fault_purpose(0))
    whole = stream.per_shot(many)
    run = stream.sequence(0, 0, 1000)
    drawn = [whole, run, *stream.uniforms(many, 4, 0).reshape(1000, -1).T, *stream.normals(many, 2, 1).T[0]]
    assert len({float(x) for numbers in drawn for x in numbers}) == sum(map(len, drawn))
    np.testing.assert_array_equal(stream.sequence(0, 300, 50), run[300:350])

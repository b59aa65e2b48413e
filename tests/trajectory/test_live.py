"""Live truth against the closed forms that it was sampled from, and what it makes of bad truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.numerics.vector_arrays import from_rotation_vector
from lidar_emu.trajectory import live
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.live_datagram import Truth, Verdict

STILL = (0.0, 0.0, 0.0)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
MS = 1_000_000


def truth(time_ns: int = 0, sequence: int = 0, **changes: object) -> Truth:
    return Truth(sequence, time_ns, STILL, STILL, STILL, UPRIGHT, STILL)._replace(**changes)  # type: ignore[arg-type]


def falling(time_s: float, known: bool = True) -> Truth:
    """From rest at a height of 500 m, with a steady drift; as a simulator would send it."""
    return Truth(
        round(time_s * 1e3), round(time_s * 1e9), (3 * time_s, 0.0, 500 - 0.8 * time_s**2), (3.0, 0.0, -1.6 * time_s),
        (0.0, 0.0, -1.6) if known else None, UPRIGHT, STILL,
    )  # fmt: skip


def flown(*truths: Truth) -> LiveTrajectory:
    trajectory = LiveTrajectory(100 * MS)
    for one in truths:
        assert trajectory.accept(one, None) is Verdict.ACCEPTED
    return trajectory


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
@settings(deadline=None)  # the first one compiles
@given(instant_s=st.floats(0.0, 1.5))
def test_constant_acceleration_is_met_exactly_between_and_beyond(instant_s: float, known: bool) -> None:
    trajectory = flown(*(falling(t, known) for t in (0.0, 0.4, 1.0)))
    state = trajectory.state(np.array([instant_s]))
    assert state.position_site_m[0] == pytest.approx([3 * instant_s, 0, 500 - 0.8 * instant_s**2], abs=1e-12)
    assert state.velocity_site_mps[0] == pytest.approx([3, 0, -1.6 * instant_s], abs=1e-12)
    assert state.acceleration_site_mps2[0] == pytest.approx([0, 0, -1.6], abs=1e-10)


def test_a_known_acceleration_makes_the_curve_of_the_fifth_degree() -> None:
    """t⁵ has every derivative that a quintic must meet; a cubic would be off by centimetres."""

    def fifth(t: float) -> Truth:
        return truth(
            round(t * 1e9),
            position_site_m=(t**5, 0.0, 0.0),
            velocity_site_mps=(5 * t**4, 0.0, 0.0),
            acceleration_site_mps2=(20 * t**3, 0.0, 0.0),
        )

    state = flown(fifth(0.5), fifth(1.5)).state(np.linspace(0.5, 1.5, 11))
    t = np.linspace(0.5, 1.5, 11)
    assert state.position_site_m[:, 0] == pytest.approx(t**5, abs=1e-12)
    assert state.velocity_site_mps[:, 0] == pytest.approx(5 * t**4, abs=1e-11)
    assert state.acceleration_site_mps2[:, 0] == pytest.approx(20 * t**3, abs=1e-10)


def test_of_many_truths_the_newest_remain() -> None:
    heights_m = [900.0 + k % 7 for k in range(200)]
    truths = [truth(k * 10 * MS, position_site_m=(0.0, 0.0, z)) for k, z in enumerate(heights_m)]
    state = flown(*truths).state(0.01 * np.arange(140, 200))
    assert state.position_site_m[:, 2] == pytest.approx(heights_m[140:], abs=1e-9)


def turned(vector_rad: np.ndarray, flip: bool) -> tuple[float, float, float, float]:
    """The quaternion of a rotation vector, of either sign."""
    angle = float(np.linalg.norm(vector_rad))
    w, *xyz = (
        math.cos(angle / 2),
        *(math.sin(angle / 2) / angle * vector_rad if angle else vector_rad).tolist(),
    )
    sign = -1.0 if flip else 1.0
    return sign * w, sign * xyz[0], sign * xyz[1], sign * xyz[2]


@pytest.mark.parametrize("flip", [False, True])
def test_a_steady_turn_between_truths_and_beyond(flip: bool) -> None:
    """Against Rodrigues' formula; between truths 50 ms apart the cubic is off by (0.05 rate)⁴/384."""
    rate = np.array([0.5, -1.0, 2.0])
    step_s = 0.05
    truths = [
        truth(
            round(k * step_s * 1e9),
            site_from_body=turned(k * step_s * rate, flip and k % 2 == 1),
            body_rate_radps=tuple(rate.tolist()),
        )
        for k in range(4)
    ]
    instants_s = np.linspace(0, 0.3, 25)
    state = flown(*truths).state(instants_s)
    error = np.abs(state.site_from_body - from_rotation_vector(instants_s[:, None] * rate))
    assert error[instants_s <= 0.15].max() < 3e-7
    assert error.max() < 1e-6
    assert np.abs(state.body_rate_radps - rate).max() < 1e-3


def rolling(step_s: float, last_s: float) -> LiveTrajectory:
    """±0.2 degrees at 3 Hz, reported every `step_s`."""
    count = round(last_s / step_s) + 1
    angle, rate, _ = roll(step_s * np.arange(count))
    return flown(
        *(
            truth(
                round(k * step_s * 1e9),
                site_from_body=turned(np.array([angle[k], 0.0, 0.0]), flip=False),
                body_rate_radps=(float(rate[k]), 0.0, 0.0),
            )
            for k in range(count)
        )
    )


def roll(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    swing, angle = 6 * np.pi, np.radians(0.2)
    return (
        angle * np.sin(swing * time_s),
        angle * swing * np.cos(swing * time_s),
        -angle * swing**2 * np.sin(swing * time_s),
    )


def test_angular_acceleration_between_truths_and_just_beyond() -> None:
    """An error of h²/12 times the fourth derivative at the ends of a step h, and of one derivative more beyond."""
    step_s = 0.01
    trajectory, largest = rolling(step_s, 0.2), np.radians(0.2) * (6 * np.pi) ** 2
    for until_s, share in ((0.2, 0.004), (0.202, 0.05)):
        time_s = np.linspace(until_s - 0.002, until_s, 21)[1:]
        state = trajectory.state(time_s)
        angle, rate, acceleration = roll(time_s)
        found = state.angular_acceleration_body_radps2
        assert found == pytest.approx(np.stack([acceleration, 0 * angle, 0 * angle], 1), abs=share * largest)
        assert state.body_rate_radps[:, 0] == pytest.approx(rate, abs=share * largest * 0.002)
        assert state.site_from_body[:, 2, 1] == pytest.approx(np.sin(angle), abs=share * largest * 0.002**2)


def test_an_extrapolated_turn_is_steady_after_one_step() -> None:
    """Without new truth the vehicle does not spin up."""
    step_s = 0.01
    trajectory = rolling(step_s, 0.25)
    newest = trajectory.state(np.array([0.25]))
    later = trajectory.state(np.array([0.26, 0.2600001, 0.5, 5.0]))
    gained = newest.angular_acceleration_body_radps2 * step_s
    assert later.body_rate_radps == pytest.approx(np.repeat(newest.body_rate_radps + gained, 4, 0), abs=1e-12)
    assert np.array_equal(later.angular_acceleration_body_radps2[1:], np.zeros((3, 3)))
    assert np.abs(newest.angular_acceleration_body_radps2).max() > 0.5
    # The attitude follows the rate: half a step of acceleration, then the steady turn.
    rate, bend = newest.body_rate_radps[0], newest.angular_acceleration_body_radps2[0]
    turn = rate * 0.25 + bend * step_s * (0.25 - step_s / 2)
    expected = newest.site_from_body[0] @ from_rotation_vector(turn[None])[0]
    assert later.site_from_body[2] == pytest.approx(expected, abs=1e-12)


def test_a_single_truth_turns_steadily() -> None:
    state = flown(truth(body_rate_radps=(0.1, 0.2, -0.3))).state(np.array([-0.1, 0.0, 1.0]))
    assert not state.angular_acceleration_body_radps2.any()
    assert np.array_equal(state.body_rate_radps, np.tile([0.1, 0.2, -0.3], (3, 1)))


@pytest.mark.parametrize(
    ("bad", "now_ns", "verdict"),
    [
        (None, None, Verdict.MALFORMED),
        (truth(2 * MS, position_site_m=(math.nan, 0.0, 0.0)), None, Verdict.NOT_FINITE),
        (truth(2 * MS, body_rate_radps=(0.0, math.inf, 0.0)), None, Verdict.NOT_FINITE),
        (truth(2 * MS, acceleration_site_mps2=(0.0, 0.0, math.nan)), None, Verdict.NOT_FINITE),
        (truth(2 * MS, site_from_body=(0.0, 0.0, 0.0, 0.0)), None, Verdict.BAD_ATTITUDE),
        (truth(2 * MS, site_from_body=(1.0, 0.1, 0.0, 0.0)), None, Verdict.BAD_ATTITUDE),
        (truth(MS), None, Verdict.DUPLICATE),
        (truth(MS - 1), None, Verdict.OUT_OF_ORDER),
        (truth(MS + 10_000 * MS + 1), None, Verdict.IMPLAUSIBLE_TIME),
        (truth(2 * MS), 20_000 * MS, Verdict.IMPLAUSIBLE_TIME),
        (truth(2**62), 2 * MS, Verdict.IMPLAUSIBLE_TIME),
    ],
)
def test_bad_truth_is_counted_and_changes_nothing(
    bad: Truth | None, now_ns: int | None, verdict: Verdict
) -> None:
    trajectory = flown(truth(MS))
    before = trajectory.state(np.array([0.5]))
    assert trajectory.accept(bad, now_ns) is verdict
    assert trajectory.verdicts == {Verdict.ACCEPTED: 1, verdict: 1}
    assert np.array_equal(trajectory.state(np.array([0.5])).position_site_m, before.position_site_m)


def test_a_truth_far_ahead_freezes_nothing() -> None:
    """Dated 9 s ahead, and refused: those that follow are accepted as if it had not come."""
    trajectory = LiveTrajectory(100 * MS)
    for step in range(20):
        now_ns = step * 20 * MS
        assert trajectory.accept(truth(now_ns), now_ns) is Verdict.ACCEPTED
        if step == 10:
            assert trajectory.accept(truth(now_ns + 9000 * MS), now_ns) is Verdict.IMPLAUSIBLE_TIME
    assert trajectory.newest == truth(19 * 20 * MS)
    assert (trajectory.resumed, trajectory.verdicts[Verdict.OUT_OF_ORDER]) == (0, 0)


def test_truth_may_run_ahead_of_the_clock_once_it_is_believed() -> None:
    """A first truth that arrived late sets the clock back: all others are ahead by more than the allowed time."""
    trajectory, ahead_ns = LiveTrajectory(100 * MS), 150 * MS
    trajectory.accept(truth(0), None)
    verdicts = [trajectory.accept(truth(k * 20 * MS + ahead_ns), k * 20 * MS) for k in range(1, 9)]
    assert verdicts == [Verdict.IMPLAUSIBLE_TIME] * 2 + [Verdict.ACCEPTED] * 6
    assert trajectory.resumed == 1


@pytest.mark.parametrize("back_ns", [70 * MS, 2000 * MS, 9000 * MS])
def test_a_source_that_goes_back_is_believed_after_three_truths(back_ns: int) -> None:
    trajectory = LiveTrajectory(100 * MS)
    trajectory.accept(truth(20_000 * MS), None)
    verdicts, now_ns = [], 20_000 * MS
    for _ in range(4):
        now_ns += 20 * MS
        verdicts.append(trajectory.accept(truth(now_ns - back_ns), now_ns))
    refused = [Verdict.OUT_OF_ORDER] * min(2, (back_ns - 1) // (20 * MS))
    assert verdicts == refused + [Verdict.ACCEPTED] * (4 - len(refused))
    assert trajectory.newest == truth(now_ns - back_ns)
    # What was believed before is not interpolated with what is believed now.
    assert trajectory.state(np.array([20.0])).position_site_m[0] == pytest.approx([0, 0, 0])


@pytest.mark.parametrize(
    "old",
    [
        [truth(k * 60 * MS) for k in range(3)],  # more than 100 ms from first to third
        [truth(k * MS, position_site_m=(11.0 * k, 0.0, 0.0)) for k in range(3)],  # each a jump from the last
        [truth(k * MS) for k in (2, 1, 0)],
    ],
)
def test_truths_that_do_not_follow_each_other_stay_refused(old: list[Truth]) -> None:
    trajectory = LiveTrajectory(100 * MS)
    trajectory.accept(truth(5000 * MS), None)
    assert [trajectory.accept(one, 5000 * MS) for one in old] == [Verdict.OUT_OF_ORDER] * 3
    assert trajectory.newest == truth(5000 * MS)


def test_in_lockstep_time_never_goes_back() -> None:
    trajectory = flown(truth(1000 * MS))
    assert {trajectory.accept(truth(k * MS), None) for k in range(5)} == {Verdict.OUT_OF_ORDER}


def test_a_jump_is_not_interpolated_across() -> None:
    trajectory = flown(truth(0), truth(100 * MS, position_site_m=(11.0, 0.0, 0.0)))
    assert trajectory.jumped == 1
    assert trajectory.state(np.array([0.05])).position_site_m[0, 0] == 11.0
    assert flown(truth(0), truth(100 * MS, position_site_m=(9.0, 0.0, 0.0))).jumped == 0


@pytest.mark.parametrize("acceleration_mps2", [None, STILL])
def test_a_steady_flight_is_no_jump(
    acceleration_mps2: tuple[float, float, float] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "JUMP_M", 1e-6)
    flight = {"velocity_site_mps": (3.0, -2.0, -1.0), "acceleration_site_mps2": acceleration_mps2}
    later = truth(1000 * MS, 1, position_site_m=(3.0, -2.0, -1.0), **flight)
    assert flown(truth(0, **flight), later).jumped == 0


def test_missing_numbers_are_counted() -> None:
    assert flown(truth(0, 5), truth(MS, 6), truth(2 * MS, 10), truth(3 * MS, 11)).lost == 3


@given(
    count=st.integers(2, 60),
    dropped=st.sets(st.integers(0, 59)),
    delays=st.lists(st.integers(0, 8), min_size=60, max_size=60),
    repeated=st.sets(st.integers(0, 59)),
)
def test_late_and_repeated_numbers_are_not_lost(
    count: int, dropped: set[int], delays: list[int], repeated: set[int]
) -> None:
    sent = [n for n in range(count) if n not in dropped]
    arrived = sorted([*sent, *(n for n in sent if n in repeated)], key=lambda n: n + delays[n])
    # Those before the first to arrive are not known to have been sent.
    known = range(arrived[0], max(arrived) + 1) if arrived else range(0)
    trajectory = LiveTrajectory(100 * MS)
    for number in arrived:
        trajectory.accept(truth(number * MS, 1000 + number), None)
    assert trajectory.lost == len(set(known) - set(arrived))


def test_a_simulator_that_counts_anew_loses_nothing() -> None:
    assert flown(truth(0, 9000), truth(MS, 9001), truth(2 * MS, 0), truth(3 * MS, 1)).lost == 0
    endless = flown(truth(0, 0), truth(MS, 2**32 - 1))
    assert endless.lost == 2**32 - 2
    assert len(endless._missing) == 256


def test_before_the_first_truth_there_is_no_state() -> None:
    with pytest.raises(ValueError, match="no truth yet"):
        LiveTrajectory(100 * MS).state(np.array([0.0]))


def test_a_warm_up_has_no_consequence() -> None:
    truths = [falling(t) for t in np.arange(0.0, 7.0, 0.1)]  # more than are kept
    warmed, plain = flown(truths[0]), flown(truths[0])
    instants_s = np.linspace(0.0, 8.0, 50)
    for one in truths[1:]:
        warmed.warm_up(one)
        assert warmed.newest == plain.newest
        for trajectory in (warmed, plain):
            trajectory.accept(one, None)
        for mine, other in zip(warmed.state(instants_s), plain.state(instants_s), strict=True):
            assert np.array_equal(mine, other)
    assert (warmed.lost, warmed.jumped, warmed.verdicts) == (plain.lost, plain.jumped, plain.verdicts)

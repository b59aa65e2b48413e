"""The device's clock against its closed form, and against small steps of the same differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from devices import MS, Unit
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.device.clock import powered_up
from lidar_emu.device.frequency_noise import FrequencyNoise
from lidar_emu.scenario.device import DeviceClock

S = 1000 * MS
DAY_S = 86_400.0


def test_a_clock_without_error_shows_scenario_time() -> None:
    clock = powered_up(DeviceClock(), 0)
    assert clock.is_exact
    assert clock.reads_ns(10**16 + 1) == 10**16 + 1


def test_offset_drift_and_ageing_add_up() -> None:
    """After 1000 s: 2 s, 1000 s * 5 ppm = 5 ms, and half of 10 ppm a day * (1000 s)^2 / 86400 s = 57.870 us."""
    clock = powered_up(DeviceClock(offset_s=2.0, drift_ppm=5.0, ageing_ppm_per_day=10.0), 0)
    assert clock.reads_ns(1000 * S) == 1002 * S + 5 * MS + 57_870


@given(
    st.floats(-100, 100), st.floats(-1000, 1000), st.integers(0, 10**12), st.integers(0, 10**12), st.integers(0, 10**12)
)  # fmt: skip
def test_a_set_clock_gains_what_a_rate_that_is_integrated_gains(
    drift_ppm: float, ageing: float, on_ns: int, set_after_ns: int, read_after_ns: int
) -> None:
    part = DeviceClock(drift_ppm=drift_ppm, ageing_ppm_per_day=ageing)
    set_ns = on_ns + set_after_ns
    clock = powered_up(part, on_ns).set_to(5 * S, set_ns)
    time_s = np.linspace(0, read_after_ns * 1e-9, 1001)
    rate = 1e-6 * (drift_ppm + ageing * (set_after_ns * 1e-9 + time_s) / DAY_S)
    gained_s = np.sum((rate[1:] + rate[:-1]) / 2) * (time_s[1] - time_s[0])
    read_ns = clock.reads_ns(set_ns + read_after_ns)
    assert read_ns - 5 * S - read_after_ns == pytest.approx(
        gained_s * 1e9, abs=2 + 1e-9 * abs(gained_s) * 1e9
    )


@given(st.integers(-(10**13), 10**13), st.lists(st.integers(0, 10**13), min_size=1))
def test_arrays_read_as_single_times_do_and_never_below_0(offset_ns: int, times_ns: list[int]) -> None:
    part = DeviceClock(offset_s=offset_ns * 1e-9, drift_ppm=123.4, ageing_ppm_per_day=-7.0)
    clock = powered_up(part, 77)
    read = clock.reads_ns(np.array(times_ns, dtype=np.int64))
    assert read.tolist() == [clock.reads_ns(time_ns) for time_ns in times_ns]
    assert read.min() >= 0


def test_time_at_the_tone_sets_the_clock_and_its_error_grows_anew() -> None:
    unit = Unit(clock={"offset_s": 0.3, "drift_ppm": 20.0, "locked_at_start": False, "holdover_s": 10.0})
    assert not unit.state.clock_locked
    assert unit.command(5000, "time_at_tone", tone_ns=5 * S) == "accepted"
    assert unit.state.clock_locked
    assert unit.state.clock.reads_ns(5 * S) == 5 * S
    assert unit.state.clock.reads_ns(6 * S) == 6 * S + 20_000
    assert unit.at(14_999).clock_locked
    assert not unit.at(15_000).clock_locked
    assert unit.command(16_000, "time_at_tone", tone_ns=16 * S) == "accepted"
    assert unit.at(16_000).clock_locked


def test_the_tone_may_lie_before_the_command() -> None:
    from lidar_emu.device.commands import DeviceCommand, execute

    unit = Unit()
    pulse = DeviceCommand("time_at_tone", {"tone_ns": 100 * S}, 1_020 * MS, 1_000 * MS)
    state, verdict = execute(unit.constants, unit.state, pulse)
    assert verdict == "accepted"
    assert state.clock.reads_ns(1_020 * MS) == 100 * S + 20 * MS


SEEDS = range(20)


def wandering(seed: int, rms: float = 1e-6) -> FrequencyNoise:
    wander = FrequencyNoise.drawn(rms, seed)
    assert wander is not None
    return wander


def test_a_rate_wanders_as_far_as_it_is_told_to_and_its_allan_deviation_is_nearly_the_same_at_all_times() -> (
    None
):
    """Flicker noise of the same power per octave: h ln(20000 s / 20 s) = rms^2, and 2 ln(2) h its Allan variance."""
    time_s = np.arange(0.0, 200_000.0)
    gained = np.stack([wandering(seed).gained_ns(0.0, 1e9 * time_s) for seed in SEEDS]) * 1e-9
    assert np.sqrt(np.mean(np.diff(gained) ** 2)) == pytest.approx(1e-6, rel=0.05)
    expected = 1e-6 * np.sqrt(2 * np.log(2) / np.log(1000))
    for span in (10, 30, 100, 300, 1000):
        second = gained[:, 2 * span :] - 2 * gained[:, span:-span] + gained[:, : -2 * span]
        assert np.sqrt(np.mean(second**2) / 2) / span == pytest.approx(expected, rel=0.3)


def test_another_seed_wanders_otherwise_and_the_same_one_alike() -> None:
    assert wandering(1) == wandering(1) != wandering(2)
    assert FrequencyNoise.drawn(0.0, 1) is None


@given(st.integers(0, 10**13), st.integers(0, 10**13), st.lists(st.integers(0, 10**13), min_size=1))
def test_a_wandering_clock_gains_from_when_it_was_set(
    powered_ns: int, set_ns: int, times_ns: list[int]
) -> None:
    clock = powered_up(DeviceClock(), powered_ns, noise=wandering(3)).set_to(5 * S, powered_ns + set_ns)
    assert not clock.is_exact
    assert clock.reads_ns(powered_ns + set_ns) == 5 * S
    later_ns = [powered_ns + set_ns + time_ns for time_ns in times_ns]
    read = clock.reads_ns(np.array(later_ns, dtype=np.int64))
    assert read.tolist() == [clock.reads_ns(time_ns) for time_ns in later_ns]
    gained_ns = read - 5 * S - np.array(times_ns)
    # Ten sines of half a turn each, all at their worst: each gains its amplitude times its period over pi.
    assert np.abs(gained_ns).max() <= np.sqrt(0.2) * 1e-6 * 37_308e9 / np.pi

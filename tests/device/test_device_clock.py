"""The device's clock against its closed form, and against small steps of the same differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from devices import MS, Unit
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.device.clock import powered_up
from lidar_emu.scenario.device import DeviceClock

S = 1000 * MS
DAY_S = 86_400.0


def test_a_clock_without_error_shows_scenario_time() -> None:
    clock = powered_up(DeviceClock(), 0)
    assert clock.is_right
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
    from lidar_emu.device.obey import Order, obey

    unit = Unit()
    pulse = Order("time_at_tone", {"tone_ns": 100 * S}, 1_020 * MS, 1_000 * MS)
    state, verdict = obey(unit.rules, unit.state, pulse)
    assert verdict == "accepted"
    assert state.clock.reads_ns(1_020 * MS) == 100 * S + 20 * MS

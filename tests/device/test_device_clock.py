"""The device's clock against its closed form."""

from __future__ import annotations

import numpy as np
import pytest
from devices import MS, Unit
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.device.state import powered_up
from lidar_emu.scenario.device import DeviceClock

S = 1000 * MS


def test_a_clock_without_error_shows_scenario_time() -> None:
    clock = powered_up(DeviceClock(), 0)
    assert clock.is_exact
    assert clock.reads_ns(10**16 + 1) == 10**16 + 1


@given(
    st.floats(-1000, 1000), st.integers(0, 10**12), st.integers(0, 10**12), st.integers(0, 10**12)
)  # fmt: skip
def test_a_set_clock_drifts_from_when_it_was_set(
    drift_ppm: float, on_ns: int, set_after_ns: int, read_after_ns: int
) -> None:
    set_ns = on_ns + set_after_ns
    clock = powered_up(DeviceClock(drift_ppm=drift_ppm), on_ns).set_to(5 * S, set_ns)
    gained_ns = clock.reads_ns(set_ns + read_after_ns) - 5 * S - read_after_ns
    assert gained_ns == pytest.approx(drift_ppm * 1e-6 * read_after_ns, abs=2)


@given(st.integers(-(10**13), 10**13), st.lists(st.integers(0, 10**13), min_size=1))
def test_arrays_read_as_single_times_do_and_never_below_0(offset_ns: int, times_ns: list[int]) -> None:
    part = DeviceClock(offset_s=offset_ns * 1e-9, drift_ppm=123.4)
    clock = powered_up(part, 77)
    read = clock.reads_ns(np.array(times_ns, dtype=np.int64))
    assert read.tolist() == [clock.reads_ns(time_ns) for time_ns in times_ns]
    assert read.min() >= 0


def test_the_tone_may_lie_before_the_command() -> None:
    from lidar_emu.device.commands import DeviceCommand, execute

    unit = Unit()
    pulse = DeviceCommand("time_at_tone", {"tone_ns": 100 * S}, 1_020 * MS, 1_000 * MS)
    state, verdict = execute(unit.constants, unit.state, pulse)
    assert verdict == "accepted"
    assert state.clock.reads_ns(1_020 * MS) == 100 * S + 20 * MS

"""How much is listened to, against the arithmetic of a bucket that leaks."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.runtime.command_handler import RateLimiter

S = 1_000_000_000


def test_a_burst_fits_and_what_comes_at_the_steady_rate_always_does() -> None:
    limiter = RateLimiter()
    assert limiter.take(4096, 0) == 4096
    assert limiter.take(10, 0) == 0
    assert [limiter.take(16, k * S // 1000) for k in range(1, 5000)] == [16] * 4999
    assert limiter.refused_bytes == 10


@given(st.lists(st.tuples(st.integers(0, 5 * S), st.integers(0, 70_000)), min_size=1))
def test_never_more_than_the_buffer_and_what_has_drained(arrivals: list[tuple[int, int]]) -> None:
    limiter, now_ns, taken, came = RateLimiter(), 0, 0, 0
    for wait_ns, size in arrivals:
        now_ns += wait_ns
        took = limiter.take(size, now_ns)
        assert 0 <= took <= size
        taken, came = taken + took, came + size
        assert taken <= 4096 + 16_000 * now_ns / S + 1
    assert limiter.refused_bytes == came - taken

"""Numbers, times and layouts: to the wire and back, at the ends and beyond."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_protocol import EncodeError, default_interface
from lidar_protocol.fields import Field, Number, ticks_from_ns
from lidar_protocol.layout import Layout, PlacedField

PACKET = default_interface().packet
FIELDS = {placed.field.name: placed.field.codec for placed in (*PACKET.header.placed, *PACKET.beam.placed)}


def encode(name, value):
    """The bits of a field alone at the start of a block."""
    codec = FIELDS[name]
    layout = Layout((codec.bits + 7) // 8, (PlacedField(Field("x", codec), 0),))
    return int.from_bytes(layout.pack({"x": value}), "big") >> -codec.bits % 8


def decode(name, raw):
    """The value of a field alone at the start of a block."""
    codec = FIELDS[name]
    layout = Layout((codec.bits + 7) // 8, (PlacedField(Field("x", codec), 0),))
    return layout.unpack((raw << -codec.bits % 8).to_bytes(layout.length, "big"))["x"]


NUMBERS = {name: codec for name, codec in FIELDS.items() if isinstance(codec, Number)}


@given(st.data())
def test_a_value_comes_back_to_half_a_step(data):
    name = data.draw(st.sampled_from(sorted(NUMBERS)))
    codec = NUMBERS[name]
    low, high = codec.limits
    value = data.draw(st.floats(low, high))
    back = decode(name, encode(name, value))
    assert abs(back - value) <= 0.5 / codec.steps_per_unit * (1 + 1e-9) + 1e-9 * abs(value)


@pytest.mark.parametrize("name", sorted(NUMBERS))
def test_every_raw_value_near_the_ends_is_a_fixed_point(name):
    codec = NUMBERS[name]
    for raw in (codec.lowest, codec.lowest + 1, codec.highest - 1, codec.highest):
        pattern = raw % (1 << codec.bits)
        assert encode(name, decode(name, pattern)) == pattern


@pytest.mark.parametrize(
    ("name", "too_much", "pattern"),
    [
        ("range_m", -0.001, 0xFFFFFFFF),
        ("range_m", 4294967.295, 0xFFFFFFFF),
        ("range_m", math.inf, 0xFFFFFFFF),
        ("range_m", 1e308, 0xFFFFFFFF),
        ("closing_speed_mps", 214748.3648, 0x80000000),
        ("closing_speed_mps", -math.inf, 0x80000000),
        ("beam_angle_deg", 90.01, 0xFFFF),
        ("sigma_range_m", 6.5535, 0xFFFE),
        ("sigma_range_m", math.inf, 0xFFFE),
        ("snr_db", 400.0, 0x7FFF),
        ("snr_db", -math.inf, 0x8001),
        ("residual_mps", -3.28, 0x8001),
        ("returns", 16, 15),
    ],
)
def test_a_value_outside_its_range_never_wraps(name, too_much, pattern):
    assert encode(name, too_much) == pattern


@pytest.mark.parametrize("name", sorted(name for name, codec in NUMBERS.items() if codec.none is not None))
@pytest.mark.parametrize("missing", [None, math.nan])
def test_no_value_is_sent_as_its_code_and_comes_back_as_none(name, missing):
    codec = NUMBERS[name]
    raw = encode(name, missing)
    assert raw == codec.none % (1 << codec.bits)
    assert decode(name, raw) is None


def test_without_a_code_no_value_is_refused():
    with pytest.raises(EncodeError):
        encode("reason", None)
    with pytest.raises(EncodeError):
        encode("shot", None)


def test_a_raw_value_outside_the_range_is_no_value():
    assert decode("beam_angle_deg", 9001) is None


def ns_from_ticks(ticks: int) -> int:
    return round(Fraction(ticks * 10**9, 2**24))


@given(st.integers(0, 2**56 - 1))
def test_every_tick_of_the_time_code_survives(ticks):
    assert ticks_from_ns(ns_from_ticks(ticks)) == ticks


@given(st.integers(0, 2**32 * 10**9 - 30))
def test_a_time_comes_back_to_half_a_tick(time_ns):
    assert abs(ns_from_ticks(ticks_from_ns(time_ns)) - time_ns) <= 30


@pytest.mark.parametrize("time_ns", [-30, 2**32 * 10**9])
def test_a_time_that_the_code_cannot_hold_is_refused(time_ns):
    with pytest.raises(EncodeError, match="epoch"):
        ticks_from_ns(time_ns)


def test_a_missing_field_is_named():
    with pytest.raises(EncodeError, match="range_valid is missing"):
        PACKET.beam.pack({"fired": True})

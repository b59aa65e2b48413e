"""Byte stuffing against published examples, and as a property."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_protocol import DecodeError, cobs

RUN = bytes(range(1, 256))
# The examples of Wikipedia's article on COBS.
PUBLISHED = [
    ("00", "0101"),
    ("0000", "010101"),
    ("001100", "01021101"),
    ("11220033", "0311220233"),
    ("11223344", "0511223344"),
    ("11000000", "0211010101"),
    (RUN[:254].hex(), "ff" + RUN[:254].hex()),
    ("00" + RUN[:254].hex(), "01ff" + RUN[:254].hex()),
    (RUN.hex(), "ff" + RUN[:254].hex() + "02ff"),
    (RUN[1:].hex() + "00", "ff" + RUN[1:].hex() + "0101"),
    (RUN[2:].hex() + "0001", "fe" + RUN[2:].hex() + "0201"),
]


@pytest.mark.parametrize(("plain", "stuffed"), PUBLISHED)
def test_published_examples(plain, stuffed):
    assert cobs.encode(bytes.fromhex(plain)).hex() == stuffed
    assert cobs.decode(bytes.fromhex(stuffed)).hex() == plain


LONG_RUNS = st.lists(st.sampled_from([b"\0", b"x", b"x" * 253, b"x" * 254, b"x" * 255, b"x" * 508])).map(
    b"".join
)


@given(st.binary(max_size=2000) | LONG_RUNS)
def test_any_bytes_come_back_and_no_zero_is_sent(data):
    stuffed = cobs.encode(data)
    assert 0 not in stuffed
    assert cobs.decode(stuffed) == data
    assert len(stuffed) <= cobs.stuffed_length(len(data))


def test_the_stated_longest_length_is_reached():
    for length in (1, 253, 254, 255, 508, 509):
        assert len(cobs.encode(b"x" * length)) == cobs.stuffed_length(length)


@pytest.mark.parametrize("stuffed", ["", "00", "05112233", "0311000233", "ff11"])
def test_what_is_not_a_frame_is_refused(stuffed):
    with pytest.raises(DecodeError) as caught:
        cobs.decode(bytes.fromhex(stuffed))
    assert caught.value.fault == "bad_stuffing"

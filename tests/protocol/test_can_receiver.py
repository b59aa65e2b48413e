"""The host's side of a CAN bus: sets, gaps, strangers, anything."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_icd import example
from lidar_protocol import CanReceiver, Device, EncodeError, default_interface

INTERFACE = default_interface()
OWN_IDS = range(0x100, 0x500)


def frames(shot, can_set="core", unit=0, beams=example.BEAMS):
    return Device(INTERFACE, unit).can_frames(can_set, {**example.HEADER, "shot": shot}, beams)


def feed(receiver, sent):
    return [message for frame in sent for message in receiver.receive(frame.can_id, frame.data, frame.is_fd)]


@pytest.mark.parametrize("can_set", ["core", "full", "fd"])
def test_the_order_after_the_header_does_not_matter(can_set):
    header, *rest = frames(5, can_set)
    ((there,), (back,)) = (feed(CanReceiver(INTERFACE), [header, *order]) for order in (rest, rest[::-1]))
    assert there == back


def test_a_missing_frame_costs_its_shot_and_a_missing_shot_is_counted():
    receiver = CanReceiver(INTERFACE)
    sent = frames(1) + frames(2)[:3] + frames(2)[4:] + frames(3) + frames(6)
    messages = feed(receiver, sent)
    assert len(messages) == 3
    counters = receiver.counters
    assert (counters.incomplete, counters.sequence_gaps, counters.lost_shots) == (1, 1, 2)


NEAR = [{**beam, "range_m": 1.0} for beam in example.BEAMS]


@pytest.mark.parametrize("can_set", ["core", "full", "fd"])
def test_a_shot_sixteen_later_takes_the_place_of_one_without_its_tail(can_set):
    receiver = CanReceiver(INTERFACE)
    assert feed(receiver, frames(4, can_set)[:-1]) == []
    (message,) = feed(receiver, frames(20, can_set, beams=NEAR))
    assert message.beams[0]["range_m"] == 1.0
    assert receiver.counters.incomplete == 1


@pytest.mark.parametrize("can_set", ["core", "full", "fd"])
def test_frames_without_their_header_do_not_join_the_next_shot_of_the_same_counter(can_set):
    receiver = CanReceiver(INTERFACE)
    late, early = frames(4, can_set)[-2:], frames(20, can_set, beams=NEAR)[:-2]
    assert feed(receiver, late + early) == []
    counters = receiver.counters
    assert (counters.orphans, receiver.buffered_frames) == (2, len(early))
    assert len(feed(receiver, frames(21, can_set))) == 1
    assert (counters.orphans, counters.incomplete, counters.lost_shots) == (2, 1, 0)


@given(st.sampled_from(["core", "full", "fd"]), st.data())
def test_a_tail_and_a_head_sixteen_shots_later_are_not_mixed(can_set, data):
    """Shot 4 loses its tail and shot 20 its head; where both break at the same frame, nothing shows it."""
    sent, later = frames(4, can_set), frames(20, can_set, beams=NEAR)
    kept = data.draw(st.integers(1, len(sent) - 1))
    lost = data.draw(st.integers(1, len(sent) - 1).filter(lambda lost: lost != kept))
    receiver = CanReceiver(INTERFACE)
    (message,) = feed(receiver, sent[:kept] + later[lost:] + frames(21, can_set, beams=NEAR))
    assert message.beams[0]["range_m"] == 1.0
    counters = receiver.counters
    assert (counters.messages, counters.incomplete) == (1, 1)
    assert counters.orphans == (len(later) - lost if lost < kept else 0)


def test_a_shot_without_its_header_is_lost_and_its_frames_are_orphans():
    receiver = CanReceiver(INTERFACE)
    messages = feed(receiver, frames(1) + frames(2)[1:] + frames(3))
    assert len(messages) == 2
    counters = receiver.counters
    assert (counters.orphans, counters.incomplete, counters.lost_shots) == (4, 0, 1)


def test_a_frame_that_comes_twice_after_its_shot_is_an_orphan():
    receiver = CanReceiver(INTERFACE)
    messages = feed(receiver, [*frames(1), frames(1)[-1], *frames(2)])
    assert len(messages) == 2
    counters = receiver.counters
    assert (counters.orphans, counters.incomplete, counters.lost_shots) == (1, 0, 0)


def test_a_message_that_the_header_does_not_announce_ends_the_shot():
    receiver = CanReceiver(INTERFACE)
    stranger = frames(1, "full")[-1]
    assert feed(receiver, [*frames(1)[:-1], stranger, frames(1)[-1]]) == []
    assert (receiver.counters.orphans, receiver.counters.incomplete) == (2, 1)


@pytest.mark.parametrize("stated", [0, 9, 255])
def test_a_header_with_an_impossible_number_of_beams_is_no_message(stated):
    receiver = CanReceiver(INTERFACE)
    header, *beams = frames(1, "fd")
    data = bytearray(header.data)
    data[18] = stated
    assert feed(receiver, [header._replace(data=bytes(data)), *beams]) == []
    assert (receiver.counters.orphans, receiver.counters.incomplete) == (len(beams), 1)
    assert len(feed(receiver, frames(2, "fd"))) == 1


def test_a_restart_counts_as_a_gap():
    receiver = CanReceiver(INTERFACE)
    assert len(feed(receiver, frames(100) + frames(0))) == 2
    assert receiver.counters.lost_shots == (0 - 100 - 1) % 16


def test_units_are_put_together_apart():
    receiver = CanReceiver(INTERFACE)
    interleaved = [
        frame for pair in zip(frames(1, unit=2), frames(9, unit=15), strict=True) for frame in pair
    ]
    assert [message.unit for message in feed(receiver, interleaved)] == [2, 15]
    assert receiver.counters.incomplete == receiver.counters.lost_shots == 0


def test_the_number_of_beams_may_change():
    receiver = CanReceiver(INTERFACE)
    messages = feed(receiver, frames(1) + frames(2, beams=example.BEAMS[:3]) + frames(3))
    assert [len(message.beams) for message in messages] == [4, 3, 4]


def test_strangers_and_wrong_lengths_are_counted():
    receiver = CanReceiver(INTERFACE)
    assert receiver.receive(0x0FF, bytes(8), False) == []
    assert receiver.receive(0x100, bytes(8), True) == []
    assert receiver.receive(0x100, bytes(7), False) == []
    assert receiver.receive(0x100, b"", False) == []
    assert (receiver.counters.unknown_ids, receiver.counters.bad_length, receiver.counters.frames) == (
        2,
        2,
        4,
    )


@given(
    st.lists(
        st.tuples(st.integers(0, 0x7FF) | st.sampled_from(OWN_IDS), st.binary(max_size=64), st.booleans())
    )
)
def test_nothing_that_arrives_raises(sent):
    receiver = CanReceiver(INTERFACE)
    for can_id, data, is_fd in sent:
        receiver.receive(can_id, data, is_fd)
    assert receiver.counters.frames == len(sent)


@pytest.mark.slow
@given(st.data())
def test_frames_of_the_right_length_with_any_content_do_not_raise_and_stay_few(data):
    receiver = CanReceiver(INTERFACE)
    addresses = [(f.can_id, len(f.data), f.is_fd) for s in ("full", "fd") for f in frames(0, s)]
    for _ in range(60):
        can_id, length, is_fd = data.draw(st.sampled_from(addresses))
        receiver.receive(can_id, data.draw(st.binary(min_size=length, max_size=length)), is_fd)
    assert receiver.buffered_frames <= len(addresses)
    assert receiver.counters.bad_length == receiver.counters.unknown_ids == 0


@pytest.mark.parametrize("count", [0, 9])
def test_a_sender_refuses_more_beams_than_slots(count):
    with pytest.raises(EncodeError, match="slots"):
        frames(0, beams=[example.BEAMS[0]] * count)


def test_what_the_smaller_fields_on_can_do_to_a_value_outside_their_range():
    beam = {**example.BEAMS[0], "snr_db": -3.0, "time_offset_s": 1.048575}
    (message,) = feed(CanReceiver(INTERFACE), frames(0, "full", beams=[beam]))
    assert (message.beams[0]["snr_db"], message.beams[0]["time_offset_s"]) == (0.0, None)

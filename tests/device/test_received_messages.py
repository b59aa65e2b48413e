"""Messages of a host that are no commands: counted and passed on, whatever they hold, and never answered."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from devices import MS
from hypothesis import given
from hypothesis import strategies as st
from test_command_handler import DEFAULT, Line

from lidar_emu.runtime.change_queue import ChangeQueue, ReceivedMessage
from lidar_emu.transports.frames import Frame, pack_frames
from lidar_protocol import Host, shipped_interface
from lidar_protocol.packet import seal

FIELDS = DEFAULT.commands.messages_by_name["navigation"].arguments  # type: ignore[union-attr]
VALUES: dict[str, Any] = dict.fromkeys(FIELDS, 1) | {"time_ns": 10**9}


class Listening(Line):
    """A line that keeps the messages that the device passed on."""

    def __init__(self, **part: Any) -> None:
        self.passed: list[ReceivedMessage] = []
        super().__init__(**part)

    def on_host_message(self, message: ReceivedMessage) -> None:
        self.passed.append(message)

    def message(self, sequence: int, **changed: Any) -> bytes:
        host = Host(DEFAULT)
        if not self.can:
            return host.encode_message("navigation", sequence=sequence, **VALUES | changed)
        frames = host.encode_message_frames("navigation", sequence=sequence, **VALUES | changed)
        return pack_frames([Frame(frame.can_id, frame.data) for frame in frames])

    @property
    def counts(self) -> Any:
        counted = self.handler.messages_to_json()
        assert counted is not None
        return counted


@pytest.mark.parametrize("can", [False, True])
def test_messages_between_commands_leave_their_sequence_alone(can: bool) -> None:
    line = Listening(can=can)
    assert line.send(10, "no_op", 7) == "accepted"
    line.receive(line.message(200, altitude_m=None), 20 * MS)
    assert line.send(30, "set_pattern", 8, pattern=1) == "accepted"
    line.receive(line.message(203) + line.message(204), 40 * MS)
    assert [(each.time_ns, each.sequence, each.verdict) for each in line.passed] == [
        (20 * MS, 200, "accepted"),
        (40 * MS, 203, "accepted"),
        (40 * MS, 204, "accepted"),
    ]
    assert line.passed[0].values == VALUES | {"altitude_m": None}
    assert len(line.messages()) == 2, "only commands are answered"
    assert line.counts["navigation"] == {"accepted": 3, "rejected": {}, "lost": 2}
    assert line.handler.counts["commands_accepted"] == 2


def test_bad_messages_are_counted_by_what_is_wrong() -> None:
    line, link = Listening(), DEFAULT.link
    good = link.framing.packet_of(line.message(9))[link.header.length : -link.crc_length]
    for body in (good[:9] + b"\x63" + good[10:], good[:-1], good + b"\0", good[:1], good):
        line.receive(link.framing.encode(seal(link, "command", 0, 9, body)), 0)
    half = line.message(10)
    line.receive(half[:30] + half[:-4] + b"\0" + line.message(11), 0)
    assert [each.verdict for each in line.passed] == [
        *("out_of_range", "malformed", "malformed", "malformed", "accepted", "accepted")
    ]
    assert [each.sequence for each in line.passed] == [9, 9, 9, None, 9, 11]
    assert [bool(each.values) for each in line.passed] == [False] * 4 + [True] * 2
    assert line.counts["navigation"] == {
        "accepted": 2,
        "rejected": {"malformed": 3, "out_of_range": 1},
        "lost": 1,
    }
    assert line.counts["bad_crc"] + line.counts["bad_frames"] == 2
    assert line.messages() == []


def test_half_a_message_on_can() -> None:
    line = Listening(can=True)
    host = Host(DEFAULT)
    frames = host.encode_message_frames("navigation", sequence=1, **VALUES)
    line.receive(pack_frames([Frame(frame.can_id, frame.data) for frame in frames[:4]]), 0)
    line.receive(line.message(2), 0)
    assert [each.sequence for each in line.passed] == [2]
    assert line.counts["incomplete_frames"] == 4


def test_a_flood_of_messages_is_limited() -> None:
    """As of commands: 4096 bytes at once and 16000 a second."""
    line = Listening()
    one = line.message(1)
    line.receive(one * 1000, 0)
    assert 4096 // len(one) - 1 <= len(line.passed) <= 4096 // len(one)
    assert line.handler.to_json()["ignored_bytes"] == 1000 * len(one) - 4096


def test_their_times_are_the_scenario_s_and_the_device_s() -> None:
    line = Listening()
    line.send(1000, "time_at_tone", 0, tone_ns=50_000 * MS)
    line.handler.receive(line.message(1), 77 * MS, 1500 * MS)
    (message,) = line.passed
    assert (message.time_ns, message.arrived_ns, message.device_ns) == (1500 * MS, 77 * MS, 50_500 * MS)


@pytest.mark.parametrize(("start_ns", "time_ns"), [(None, 300 * MS), (1000 * MS, 200 * MS)])
def test_without_a_pace_messages_have_the_time_of_the_simulation(start_ns: int | None, time_ns: int) -> None:
    line = Listening()
    port: Any = SimpleNamespace(take_received=lambda: [(1200 * MS, line.message(1), None)])
    ChangeQueue(port, line.handler, None).receive(300 * MS, start_ns)
    assert [(each.time_ns, each.arrived_ns) for each in line.passed] == [(time_ns, 1200 * MS)]


def test_an_interface_without_messages_counts_none() -> None:
    line = Line(shipped_interface("altimeter"))
    assert line.handler.messages_to_json() is None


@given(st.lists(st.binary(max_size=120)), st.booleans())
def test_nothing_that_arrives_raises(portions: list[bytes], can: bool) -> None:
    line, host = Listening(can=can), Host(DEFAULT)
    frames = host.encode_message_frames("navigation", sequence=1, **VALUES)
    for k, portion in enumerate(portions):
        if can:
            line.receive(pack_frames([Frame(frames[k % len(frames)].can_id, portion[:8])]), 0)
        else:
            line.receive(portion, 0)
            line.receive(
                DEFAULT.link.framing.encode(seal(DEFAULT.link, "command", 0, 0, b"\x10" + portion)), 0
            )
    line.receive((b"" if can else b"\0") + line.message(5), 10**15)
    assert line.passed[-1].sequence == 5

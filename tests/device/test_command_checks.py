"""The table of a command's checks in INTERFACE.md, row by row, on a byte link and on CAN, against a reference that is
written from the table alone."""

from __future__ import annotations

import re
from binascii import crc_hqx
from pathlib import Path
from typing import NamedTuple

import pytest
from devices import MS, constants
from hypothesis import example, given
from hypothesis import strategies as st

from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.runtime.command_handler import CommandHandler, DownlinkEncoder
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_protocol import Acknowledge, CanReceiver, SerialReceiver, cobs, default_interface

INTERFACE = default_interface()
DOCUMENT = (Path(__file__).parents[2] / "protocol" / "lidar_protocol" / "INTERFACE.md").read_text()
UNIT = 2
LENGTHS = {0: 0, 1: 1, 2: 1, 3: 4, 4: 4, 6: 6, 7: 1}
"""Bytes of arguments of each command of these tests."""


class Sent(NamedTuple):
    """A command as bytes: its code, its sequence number, its arguments; `cut` bytes are missing at the end."""

    code: int
    number: int
    arguments: bytes = b""
    cut: int = 0
    unit: int = UNIT
    header_count: int = 0

    @property
    def body(self) -> bytes:
        whole = bytes((self.code, self.number)) + self.arguments
        return whole[: max(0, len(whole) - self.cut)]

    def framed(self) -> bytes:
        """By hand, from sections 2 and 4 of the document."""
        head = (0x12A0 + self.unit).to_bytes(2, "big") + (0xC000 | self.header_count).to_bytes(2, "big")
        packet = head + (len(self.body) + 2 - 1).to_bytes(2, "big") + self.body
        return b"\0" + cobs.encode(packet + crc_hqx(packet, 0xFFFF).to_bytes(2, "big")) + b"\0"

    def frame(self) -> bytes:
        """By hand, from section 5: the identifier replaces the code."""
        return pack_frames([Frame(0x130 + self.code + 0x40 * self.unit, self.body[1:])])


class Device:
    """A device on a link, and its answers."""

    def __init__(self, can: bool) -> None:
        self.can, self.sent = can, list[bytes]()
        rules = constants()
        encoder = DownlinkEncoder(INTERFACE, UNIT, can)
        timeline = DeviceTimeline(rules, initial(rules))
        self.handler = CommandHandler(encoder, timeline, lambda _: True, self.sent.append, [])

    def answer(self, command: Sent) -> tuple[int, str] | None:
        """Number and verdict of the one acknowledgement; None if there is none."""
        self.sent.clear()
        self.handler.receive(command.frame() if self.can else command.framed(), 0, MS)
        answers = list(self._answers())
        assert len(answers) <= 1
        return answers[0] if answers else None

    def _answers(self) -> list[tuple[int, str]]:
        if self.can:
            receiver = CanReceiver(INTERFACE)
            frames = [frame for payload in self.sent for frame in unpack_frames(payload)]
            received = [message for f in frames for message in receiver.receive(f.can_id, f.data, f.is_fd)]
        else:
            received = SerialReceiver(INTERFACE).receive(b"".join(self.sent))
        return [(each.sequence or 0, each.verdict) for each in received if isinstance(each, Acknowledge)]


class Table:
    """The table, for a device that is in mode track and stays there."""

    def __init__(self) -> None:
        self.last: int | None = None

    def answer(self, command: Sent, can: bool) -> tuple[int, str] | None:
        if command.unit != UNIT or (can and command.code > 7) or not (can or command.body):
            return None
        if len(command.body) < 2:
            return 0, "malformed"
        length = LENGTHS.get(command.code)
        is_right = length == len(command.body) - 2
        free = self.last is None or (command.code == 0 and is_right and command.number != self.last)
        if not free and command.number != ((self.last or 0) + 1) % 256:
            return command.number, "bad_sequence"
        self.last = command.number
        return command.number, self._verdict(command, length, is_right)

    def _verdict(self, command: Sent, length: int | None, is_right: bool) -> str:
        if length is None:
            return "unknown"
        if not is_right:
            return "malformed"
        value = int.from_bytes(command.body[2:], "big")
        match command.code:
            case 1:
                return {4: "accepted", 2: "out_of_state"}.get(value, "out_of_range")
            case 2:
                return "accepted" if value in (0, 1, 255) else "out_of_range"
            case 3:
                return "accepted" if value == 20_000 else "out_of_range"
            case 4:
                return "accepted" if value < 16 else "out_of_range"
            case 6 | 7:
                return "out_of_range"
        return "accepted"


ARGUMENTS = {
    0: [b""],
    1: [b"\x04", b"\x02", b"\x00", b"\x05", b"\x63"],  # those that leave the mode as it is
    2: [b"\x00", b"\x01", b"\x02", b"\xff"],
    3: [(20_000).to_bytes(4, "big"), bytes(4), b"\xff" * 4, (12_345).to_bytes(4, "big")],
    4: [(15).to_bytes(4, "big"), (16).to_bytes(4, "big")],
    6: [b"\x00\x01\x7f\xc0\x00\x00"],  # NaN
    7: [b"\x02", b"\xff"],  # those that do not restart it
    9: [b"", b"\x01\x02"],
}
STEPS = [0, 1, 1, 1, 1, 2, 255]


@st.composite
def conversations(draw: st.DrawFn) -> list[Sent]:
    """Commands with numbers near the last one, most of them well-formed."""
    number, commands = draw(st.integers(0, 255)), list[Sent]()
    for _ in range(draw(st.integers(1, 12))):
        number = (number + draw(st.sampled_from(STEPS))) % 256
        code = draw(st.sampled_from(sorted(ARGUMENTS)))
        arguments = draw(st.sampled_from(ARGUMENTS[code])) + draw(st.sampled_from([b""] * 6 + [b"\x00"]))
        cut = draw(st.sampled_from([0] * 6 + [1, 2, 9]))
        unit = draw(st.sampled_from([UNIT] * 8 + [0, 15]))
        commands.append(Sent(code, number, arguments, cut, unit, draw(st.integers(0, 0x3FFF))))
    return commands


@example([Sent(1, 0, b"\x04\x00", cut=1)], False)
@given(conversations(), st.booleans())
def test_every_command_is_answered_as_the_table_states(commands: list[Sent], can: bool) -> None:
    device, table = Device(can), Table()
    for command in commands:
        assert device.answer(command) == table.answer(command, can), command


PATTERN = Sent(2, 11, b"\x01")
ROWS = [
    (1, PATTERN._replace(unit=5), None),
    (2, PATTERN._replace(cut=2), (0, "malformed")),
    (3, PATTERN._replace(number=12), (12, "bad_sequence")),
    (3, Sent(2, 12, b"\x09"), (12, "bad_sequence")),
    (3, Sent(2, 12, b""), (12, "bad_sequence")),
    (3, Sent(9, 12), (12, "bad_sequence")),
    (4, Sent(9, 11), (11, "unknown")),
    (5, Sent(2, 11), (11, "malformed")),
    (5, Sent(2, 11, b"\x01\x01"), (11, "malformed")),
    (5, Sent(0, 11, b"\x01"), (11, "malformed")),
    (6, Sent(7, 11, b"\x02"), (11, "out_of_range")),
    (8, Sent(2, 11, b"\x09"), (11, "out_of_range")),
    (9, Sent(1, 11, b"\x02"), (11, "out_of_state")),
    (10, PATTERN, (11, "accepted")),
]


def table_rows() -> dict[int, tuple[str, bool]]:
    """Verdict and whether the number counts, by the order of checks, as printed."""
    rows = re.findall(r"^\| (\d+) \| [^|]+ \| (?:\d )?([a-z_ ]+) \| (yes)? ?\|$", DOCUMENT, re.MULTILINE)
    return {int(order): (verdict, bool(counts)) for order, verdict, counts in rows}


@pytest.mark.parametrize("can", [False, True])
@pytest.mark.parametrize(("row", "command", "answer"), ROWS)
def test_each_row_of_the_table(row: int, command: Sent, answer: tuple[int, str] | None, can: bool) -> None:
    verdict, counts = table_rows()[row]
    device = Device(can)
    assert device.answer(Sent(0, 10)) == (10, "accepted")
    if can and command.code > 7:
        assert device.answer(command) is None
        return
    assert device.answer(command) == answer
    assert verdict == ("no answer" if answer is None else answer[1])
    follows = 12 if counts else 11
    assert device.answer(PATTERN._replace(number=follows)) == (follows, "accepted")


@pytest.mark.parametrize("can", [False, True])
def test_not_allowed_in_this_mode(can: bool) -> None:
    """Row 7: in self-test the device takes no pattern."""
    device = Device(can)
    assert device.answer(Sent(1, 1, b"\x01")) == (1, "accepted")
    assert device.answer(Sent(1, 2, b"\x02")) == (2, "accepted")
    assert device.answer(Sent(2, 3, b"\x09")) == (3, table_rows()[7][0])
    assert table_rows()[7] == ("out_of_state", True)

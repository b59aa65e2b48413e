"""What a host receives: verdicts, sequence numbers, housekeeping, and a record of each command."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import pytest
from devices import MS, constants
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import DeviceState
from lidar_emu.errors import InputError
from lidar_emu.runtime.change_queue import Change, ChangeQueue, ReceivedCommand
from lidar_emu.runtime.command_handler import CommandHandler, DownlinkEncoder, RateLimiter
from lidar_emu.runtime.housekeeping import HousekeepingSender
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.runtime.summary import Tally
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_protocol import (
    Acknowledge,
    CanReceiver,
    Host,
    Housekeeping,
    Interface,
    SerialReceiver,
    cobs,
    default_interface,
    load,
    shipped_interface,
)

DEFAULT = default_interface()
S = 1000 * MS


class Line(Observer):
    """A host and a device, and what the device sent."""

    def __init__(self, interface: Interface = DEFAULT, can: bool = False, **part: Any) -> None:
        self.interface, self.can = interface, can
        self.sent: list[bytes] = []
        self.received: list[tuple[ReceivedCommand, int | None]] = []
        self.kept: list[tuple[bytes, int]] = []
        behaviour = constants(**part)
        self.device = DeviceTimeline(behaviour, initial(behaviour))
        encoder = DownlinkEncoder(interface, 0, can)
        self.changes: list[Change] = []
        self.handler = CommandHandler(
            encoder, self.device, lambda shown_ns: shown_ns < 1 << 61, self.sent.append, [self]
        )
        self.tally = Tally(Pace.WALL)
        self.housekeeping = HousekeepingSender(
            encoder, self.device, self.tally, self.handler, self.sent.append, [self]
        )

    def on_command(self, command: ReceivedCommand, shot: int | None) -> None:
        self.received.append((command, shot))

    def on_housekeeping(self, payload: bytes, time_ns: int) -> None:
        self.kept.append((payload, time_ns))

    def receive(self, data: bytes, time_ns: int) -> None:
        """Let the device receive bytes."""
        self.changes += self.handler.receive(data, 0, time_ns)

    def command(self, name: str, sequence: int, **arguments: Any) -> bytes:
        host = Host(self.interface)
        if not self.can:
            return host.encode_command(name, sequence=sequence, **arguments)
        frame = host.encode_command_frame(name, sequence=sequence, **arguments)
        return pack_frames([Frame(frame.can_id, frame.data)])

    def send(self, time_ms: float, name: str, sequence: int, **arguments: Any) -> str:
        """Give a command; returns the verdict that comes back."""
        self.receive(self.command(name, sequence, **arguments), round(time_ms * MS))
        answer = self.messages()[-1]
        assert isinstance(answer, Acknowledge)
        assert answer.sequence == sequence
        return answer.verdict

    def messages(self) -> list[Any]:
        """All that the host has received."""
        if not self.can:
            return list(SerialReceiver(self.interface).receive(b"".join(self.sent)))
        receiver = CanReceiver(self.interface)
        frames = [frame for payload in self.sent for frame in unpack_frames(payload)]
        return [message for f in frames for message in receiver.receive(f.can_id, f.data, f.is_fd)]


@pytest.mark.parametrize("restart", ["warm", "cold"])
def test_after_a_restart_any_number_may_come_first(restart: str) -> None:
    line = Line()
    assert line.send(0, "no_op", 3) == "accepted"
    assert line.send(1, "reset", 4, restart=restart) == "accepted"
    stated = len(line.sent)
    line.receive(line.command("no_op", 5), 100 * MS)
    assert len(line.sent) == stated, "who boots hears nothing"
    assert line.handler.to_json()["ignored_bytes"] == len(line.command("no_op", 5))
    assert line.send(4000, "set_mode", 77, mode="track") == "accepted"


def test_what_follows_a_reset_in_one_breath_is_not_heard() -> None:
    line = Line()
    line.receive(line.command("reset", 0, restart="warm") + line.command("no_op", 1), 0)
    assert [message.command for message in line.messages()] == ["reset"]


def test_a_command_that_arrives_before_time_0_adds_to_those_that_count_from_it() -> None:
    """What is received while the run waits for its host counts from 0; the flight then begins a moment later."""
    line = Line()
    line.send(0, "enable_beams", 0, beams=3)
    line.send(-60, "set_pattern", 1, pattern=1)
    line.send(-50, "time_at_tone", 2, tone_ns=7 * S)
    state = line.device.at(10 * MS)
    assert (state.settings.beams, state.settings.pattern) == (3, 1)
    assert state.clock.reads_ns(10 * MS) == 7 * S + 60 * MS, "it was set when the command arrived"


def test_a_change_waits_for_the_shots_and_is_reported_with_the_first_that_follows() -> None:
    line = Line()
    line.send(10, "no_op", 0)
    line.send(20, "set_pattern", 1, pattern=1)
    line.send(30, "set_pattern", 2, pattern=1)
    line.send(40, "set_pattern", 3, pattern=0)
    states: list[DeviceState] = []
    assert [(heard.command, shot) for heard, shot in line.received] == [
        ("no_op", None),
        ("set_pattern", None),
    ]
    first, second = line.changes
    session: Any = SimpleNamespace(use_device=lambda device: states.append(device))
    first.apply(session)
    assert first.applied is not None
    first.applied(4, 1234)
    assert [state.settings.pattern for state in states] == [1]
    assert line.received[-1] == (ReceivedCommand(20 * MS, "set_pattern", {"pattern": 1}, 1, "accepted"), 4)
    assert second.applied is not None
    second.applied(None, None)
    assert line.received[-1] == (ReceivedCommand(40 * MS, "set_pattern", {"pattern": 0}, 3, "accepted"), None)
    assert line.handler.to_json()["delay"]["count"] == 1


_COMMANDS = [
    ("no_op", {}), ("set_pattern", {"pattern": 1}), ("set_pattern", {"pattern": 9}), ("set_rate_hz", {"rate_hz": 10}),
    ("enable_beams", {"beams": 5}), ("set_mode", {"mode": "standby"}), ("set_mode", {"mode": "track"}),
    ("set_parameter", {"parameter": 1, "number": 0.5}), ("time_at_tone", {"tone_ns": 1 << 50}),
]  # fmt: skip


@given(st.lists(st.tuples(st.sampled_from(_COMMANDS), st.booleans()), max_size=8), st.booleans())
def test_a_command_beside_the_port_does_the_same_and_disturbs_no_sequence(chosen: Any, can: bool) -> None:
    """One device receives all commands from its host, the other one some of them beside the port."""
    line, other, sequence = Line(can=can), Line(can=can), 0
    for k, ((name, values), beside) in enumerate(chosen):
        verdict = line.send(10 * k, name, k, **values)
        if beside:
            changes, results = other.handler.execute([(name, values)], 0, 10 * k * MS)
            other.changes += changes
            shown_s = line.device.at(10 * k * MS).clock.reads_ns(10 * k * MS) * 1e-9
            assert results == [{"verdict": verdict, "time_s": shown_s}]
        else:
            assert other.send(10 * k, name, sequence, **values) == verdict
            sequence += 1
    assert other.device.at(S) == line.device.at(S)
    assert other.handler.counts == line.handler.counts
    assert (len(other.changes), len(other.messages())) == (len(line.changes), sequence)
    if not can:  # the counter of acknowledgement packets has no gap
        counts = [int.from_bytes(cobs.decode(sent.strip(b"\0"))[2:4]) & 0x3FFF for sent in other.sent]
        assert counts == list(range(sequence))


def test_beside_the_port_all_commands_are_checked_and_end_with_the_first_that_is_not_accepted() -> None:
    handler = Line().handler
    with pytest.raises(InputError, match="no_op has no range"):
        handler.execute([("set_pattern", {"pattern": 1}), ("no_op", {"range": 1})], 0, 0)
    assert handler.counts["commands_accepted"] == 0
    _, results = handler.execute([("set_pattern", {"pattern": 9}), ("no_op", {})], 0, 0)
    assert [each["verdict"] for each in results] == ["out_of_range"]
    _, results = handler.execute([("reset", {"restart": "warm"}), ("no_op", {})], 0, 0)
    assert [each["verdict"] for each in results] == ["accepted", None]


def test_a_command_of_the_port_that_was_overtaken_follows() -> None:
    """It arrived 2 ms before the one beside the port."""
    line = Line()
    port: Any = SimpleNamespace(take_received=list)
    beside = [("enable_beams", {"beams": 1})]
    queue = ChangeQueue(port, line.handler, SimpleNamespace(receive=lambda do: do(beside, 12 * MS)[0]))
    queue.receive(12 * MS, 0)
    beside.clear()
    port.take_received = lambda: [(10 * MS, line.command("set_pattern", 0, pattern=1), None)]
    queue.receive(13 * MS, 0)
    settings = line.device.at(20 * MS).settings
    assert (settings.beams, settings.pattern) == (1, 1)


def test_answers_are_dated_by_the_device_s_clock() -> None:
    line = Line(clock={"offset_s": 50.0})
    line.send(1000, "no_op", 0)
    line.send(2000, "time_at_tone", 1, tone_ns=7 * S)
    line.send(2500, "no_op", 2)
    assert [message.values["time_ns"] for message in line.messages()] == [51 * S, 7 * S, 7 * S + S // 2]


def test_a_time_that_packets_cannot_report_is_refused() -> None:
    line = Line()
    line.handler._can_encode_time = lambda shown_ns: shown_ns < 100 * S
    assert line.send(0, "time_at_tone", 0, tone_ns=100 * S) == "out_of_range"
    assert line.send(0, "time_at_tone", 1, tone_ns=99 * S) == "accepted"
    assert line.handler.counts == {"commands_accepted": 1, "commands_rejected": 1, "bad_bytes": 0}


def test_housekeeping_bit_by_bit() -> None:
    """Read by struct from INTERFACE.md, an hour after power-up."""
    line = Line()
    line.tally.statuses.update({})
    line.housekeeping.on_truth_used(3, 12_345_000, 0)
    line.housekeeping.send_due(3_600 * S)
    (payload,) = line.sent
    assert line.kept == [(payload, 3_600 * S)]
    body = cobs.decode(payload.strip(b"\0"))[6:-2]
    time_s, fraction = struct.unpack(">II", body[:4] + b"\0" + body[4:7])
    assert (time_s, fraction) == (3600, 0)
    assert body[7:11] == bytes([3, 0, 1, 0])  # interface 3, software 0.1.0
    mode, flags, temperature, power, uptime_s = struct.unpack(">BBhHI", body[11:21])
    assert (mode, flags, power, uptime_s) == (4, 0b111, 1500, 3600)
    assert temperature == 3200  # 20 + 12 degrees, in 0.01
    assert struct.unpack(">IIHHII", body[21:]) == (0, 0, 0, 0, 0, 12_345)


@pytest.mark.parametrize("restart", ["warm", "cold"])
def test_what_goes_on_after_a_restart_and_what_begins_anew(restart: str) -> None:
    """As INTERFACE.md states it."""
    line = Line(start="standby")
    assert line.send(0, "no_op", 0) == "accepted"
    line.housekeeping.send_due(2000 * MS)
    assert line.send(3000, "reset", 1, restart=restart) == "accepted"
    assert line.send(8000, "no_op", 9) == "accepted"
    line.housekeeping.send_due(9000 * MS)
    heads = [cobs.decode(payload.strip(b"\0"))[:4] for payload in line.sent]
    counts = {
        kind: [int.from_bytes(head[2:], "big") & 0x3FFF for head in heads if head[:2] == kind]
        for kind in {head[:2] for head in heads}
    }
    assert sorted(counts.values()) == [[0, 1], [0, 1, 2]]
    before, after = (message.values for message in line.messages() if isinstance(message, Housekeeping))
    assert (before["uptime_s"], after["uptime_s"]) == (2, 6)
    assert (before["commands_accepted"], after["commands_accepted"]) == (1, 3)


def test_housekeeping_comes_at_its_rate_however_shots_come() -> None:
    line = Line(start="boot", boot_s=0.5, self_test_s=1.0, housekeeping_rate_hz=2.0)
    for time_ms in range(0, 4000, 7):
        line.housekeeping.send_due(time_ms * MS)
    times_s = [message.values["time_ns"] / S for message in line.messages()]
    assert times_s == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5], abs=0.008)
    modes = [DEFAULT.word("mode", message.values["mode"]) for message in line.messages()]
    assert modes == ["self_test"] * 2 + ["standby"] * 5
    assert line.send(4000, "set_parameter", 0, parameter=0, number=0) == "accepted"
    count = len(line.kept)
    for time_ms in range(4000, 9000, 7):
        line.housekeeping.send_due(time_ms * MS)
    assert len(line.kept) == count


def test_another_rate_counts_at_once_whoever_sets_it() -> None:
    """Every 20 s by command; a cold restart, after 2 s of boot and 1 s of self-test, is back at one a second."""
    line = Line(start="standby", boot_s=2.0, self_test_s=1.0, housekeeping_rate_hz=1.0)
    assert line.send(500, "set_parameter", 0, parameter=0, number=0.05) == "accepted"
    assert line.send(3000, "reset", 1, restart="cold") == "accepted"
    for time_ms in range(0, 8000, 10):
        line.housekeeping.send_due(time_ms * MS)
    assert [time_ns // MS for _, time_ns in line.kept] == [0, 500, 5000, 6000, 7000]


def test_housekeeping_reports_its_own_time_not_of_commands_to_come() -> None:
    line = Line(start="standby")
    line.send(2000, "set_mode", 0, mode="track")
    line.housekeeping.send_due(1000 * MS)
    line.housekeeping.send_due(3000 * MS)
    reported = [message for message in line.messages() if isinstance(message, Housekeeping)]
    assert [message.values["mode"] for message in reported] == [1, 4]


def test_an_interface_with_fewer_words_states_the_nearest() -> None:
    altimeter = shipped_interface("altimeter")
    line = Line(altimeter, start="boot", boot_s=0.5, self_test_s=1.0)
    line.housekeeping.send_due(1000 * MS)
    (reported,) = line.messages()
    assert altimeter.word("state", reported.values["mode"]) == "standby"


def test_housekeeping_that_the_line_did_not_take_does_not_count_as_sent() -> None:
    line = Line(housekeeping_rate_hz=1.0)
    line.housekeeping.send_due(1000 * MS)
    line.housekeeping.on_acknowledgement(b"", 1500 * MS)
    line.housekeeping.send_due(2000 * MS)
    for sent_ns in (None, None, 2000 * MS):
        line.housekeeping.on_sent_between(sent_ns)
    assert line.housekeeping.to_json() == {"sent": 1, "encode_failures": 0}


def test_housekeeping_that_cannot_be_filled_is_refused() -> None:
    from importlib.resources import files

    text = files("lidar_protocol").joinpath("default.toml").read_text()
    strange = text.replace('[[housekeeping]]\nname = "uptime_s"', '[[housekeeping]]\nname = "mood"')
    strange = strange.replace('{ name = "uptime_s" }, ', "")
    with pytest.raises(InputError, match="mood"):
        Line(load(strange, "mine.toml"))


def test_others_on_the_bus_do_not_drown_a_command_and_a_flood_of_commands_is_not_all_heard() -> None:
    line = Line(can=True)
    others = pack_frames([Frame(0x700, bytes(8))]) * 10_000
    line.receive(others + line.command("no_op", 0), 0)
    assert [message.command for message in line.messages()] == ["no_op"]
    line.receive(b"".join(line.command("no_op", k % 256) for k in range(1, 20_000)), 0)
    assert 1_000 < len(line.messages()) < 5_000
    assert line.handler.to_json()["ignored_bytes"] > 10_000


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

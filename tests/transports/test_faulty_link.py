"""Faults of a port, on a clock that the test turns: what the link above makes of them, and what reaches the line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from lidar_emu.transports import faulty_link
from lidar_emu.transports.faulty_link import FaultyPort, PortFault
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_emu.transports.link import DeliveryStatus, Link, PortChannel
from lidar_emu.transports.spec import Kind, PortSpec, frame_bits

MS = 1_000_000
START_NS = 77_000 * MS
SERIAL = PortSpec(Kind.SERIAL, path="/dev/ttyUSB0")
PTY = PortSpec(Kind.PTY)
CAN = PortSpec(Kind.CAN, interface="socketcan", channel="vcan0")


class Line(PortChannel):
    """A port that keeps what it is given; each time that it is opened counts."""

    readable = writable = 5

    def __init__(self) -> None:
        super().__init__("line")
        self.sent: list[bytes] = []
        self.arrived: list[bytes] = []
        self.opened = 0
        self.is_open = False
        self.is_full = False

    def open(self) -> Any:
        self.opened += 1
        self.is_open = True
        return self

    def send(self, payload: bytes) -> bool:
        assert self.is_open
        if not self.is_full:
            self.sent.append(payload)
        return not self.is_full

    def receive(self) -> bytes:
        return self.arrived.pop(0) if self.arrived else b""

    def close(self) -> None:
        self.is_open = False


class Bench:
    """A link with faults, and its clock."""

    def __init__(self, spec: PortSpec, *faults: dict[str, Any]) -> None:
        self.now_ns = START_NS
        self.line = Line()
        self.port = FaultyPort(self.line.open, spec, lambda: self.now_ns)
        for number, fault in enumerate(faults):
            self.port.add({"number": number, "from_ns": 100 * MS, "to_ns": 300 * MS, **fault})
        self.link = Link(self.port)
        self.port.begin(START_NS)

    def at(self, time_ms: float) -> Bench:
        self.now_ns = START_NS + round(time_ms * MS)
        return self

    def send(self, payload: bytes) -> DeliveryStatus:
        return self.link.send(payload, self.now_ns)

    def service(self) -> Bench:
        self.link.service(self.now_ns)
        return self

    def reported(self) -> list[tuple[int, str]]:
        return [((time_ns - START_NS) // MS, text) for time_ns, text in self.link.take_events()]


def test_a_disconnected_port_is_closed_and_opened_again() -> None:
    bench = Bench(SERIAL, {"kind": "disconnect"})
    assert bench.at(99).send(b"a") is DeliveryStatus.SENT
    assert bench.at(100).send(b"b") is DeliveryStatus.DROPPED_BROKEN
    assert not bench.line.is_open
    for time_ms in range(101, 300):
        bench.at(time_ms).service()
        assert bench.send(b"c") is DeliveryStatus.DROPPED_BROKEN
    for time_ms in range(300, 2400):
        bench.at(time_ms).service()
    assert bench.send(b"d") is DeliveryStatus.SENT
    assert (bench.line.sent, bench.line.opened) == ([b"a", b"d"], 2)
    (broke, why), (again, reopened) = bench.reported()
    assert (broke, why, reopened) == (100, "link broken: disconnected by an injected fault", "reopened")
    assert 300 <= again <= 2300


def test_it_is_noticed_without_a_packet() -> None:
    bench = Bench(SERIAL, {"kind": "disconnect"})
    bench.at(150).service()
    assert not bench.line.is_open
    assert bench.link.receive(bench.now_ns) == b""


def test_what_would_not_come_back_is_kept_and_deaf() -> None:
    bench = Bench(PTY, {"kind": "disconnect"})
    assert bench.at(120).send(b"a") is DeliveryStatus.DROPPED_BROKEN
    assert bench.line.is_open
    bench.line.arrived = [b"lost"]
    for time_ms in range(300, 2400):
        bench.at(time_ms).service()
    assert bench.link.receive(bench.now_ns) == b""
    bench.line.arrived = [b"heard"]
    assert bench.link.receive(bench.now_ns) == b"heard"
    assert bench.line.opened == 1


def test_bus_off_is_reported_as_a_real_one_is_and_the_bus_stays_open() -> None:
    bench = Bench(CAN, {"kind": "bus_off"})
    frames = pack_frames([Frame(0x100, b"12345678")])
    assert bench.at(150).send(frames) is DeliveryStatus.DROPPED_BROKEN
    assert bench.reported() == [(150, "link broken: bus off by an injected fault")]
    for time_ms in range(300, 2400):
        bench.at(time_ms).service()
    assert bench.send(frames) is DeliveryStatus.SENT
    assert (bench.line.opened, bench.line.sent) == (1, [frames])


def test_a_slow_line_lets_packets_out_one_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faulty_link, "BUFFER_BYTES", 12)
    # 1000 bits a second: a packet of 5 bytes takes 50 ms.
    bench = Bench(SERIAL, {"kind": "slow_line", "rate": 1000.0})
    assert bench.at(99).send(b"00000") is DeliveryStatus.SENT
    assert bench.line.sent == [b"00000"]
    assert [bench.at(120).send(packet) for packet in (b"11111", b"22222", b"33333")] == [
        DeliveryStatus.SENT, DeliveryStatus.SENT, DeliveryStatus.DROPPED_FULL,
    ]  # fmt: skip
    assert bench.link.pending
    assert bench.link.unread == 10
    assert bench.link.wake_ns(bench.now_ns, False) == bench.now_ns + MS
    left = []
    for time_ms in range(121, 260):
        before = len(bench.line.sent)
        bench.at(time_ms).service()
        left += [time_ms] * (len(bench.line.sent) - before)
    assert left == [170, 220]
    assert bench.line.sent == [b"00000", b"11111", b"22222"]
    assert not bench.link.pending
    # At the end of the window what waits goes first.
    assert bench.at(290).send(b"44444") is DeliveryStatus.SENT
    assert bench.at(300).send(b"55555") is DeliveryStatus.SENT
    bench.at(340).service()
    assert bench.line.sent[3:] == [b"44444", b"55555"]
    assert bench.at(341).send(b"6") is DeliveryStatus.SENT
    assert bench.line.sent[-1] == b"6"


def test_a_slow_bus_counts_all_bits_of_frames() -> None:
    frames = [Frame(0x100, b"12345678"), Frame(0x101, b"1")]
    bits = sum(sum(frame_bits(frame)) for frame in frames)
    bench = Bench(CAN, {"kind": "slow_line", "rate": 1e4})
    bench.at(100).send(pack_frames(frames))
    wire_ms = bits / 1e4 * 1e3
    assert not bench.at(100 + wire_ms - 0.1).service().line.sent
    assert bench.at(100 + wire_ms + 0.1).service().line.sent


def test_a_slow_line_reports_a_full_one_below(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faulty_link, "BUFFER_BYTES", 300)
    bench = Bench(SERIAL, {"kind": "slow_line", "rate": 1e5})
    bench.line.is_full = True
    bench.at(100).send(b"a" * 200)
    bench.at(200).service()
    assert bench.send(b"b" * 200) is DeliveryStatus.DROPPED_FULL
    bench.line.is_full = False
    bench.service()
    assert bench.line.sent == [b"a" * 200]


@pytest.mark.parametrize("step_ms", [1, 7, 30])
def test_babble_comes_at_its_rate_and_is_the_same_however_often_one_looks(step_ms: int) -> None:
    order = {"kind": "babble", "rate": 2000.0, "seed": 5}
    bench = Bench(SERIAL, order)
    for time_ms in range(0, 400, step_ms):
        bench.at(time_ms).service()
    noise = b"".join(bench.line.sent)
    # The last look within the window was up to a step before its end.
    assert 400 - 2 * step_ms <= len(noise) <= 400
    assert noise == PortFault(0, "babble", 100 * MS, 300 * MS, 5, 2000.0).noise(0, len(noise))
    assert noise != PortFault(0, "babble", 100 * MS, 300 * MS, 6, 2000.0).noise(0, len(noise))
    assert len(set(noise)) > 150


def test_babble_stays_between_packets_and_packets_keep_their_order() -> None:
    bench = Bench(SERIAL, {"kind": "babble", "rate": 5000.0})
    packets = [bytes([k]) * 3000 for k in range(1, 40)]
    for k, packet in enumerate(packets):
        assert bench.at(95 + 5 * k).service().send(packet) is DeliveryStatus.SENT
    assert [sent for sent in bench.line.sent if sent in packets] == packets
    assert len(bench.line.sent) > len(packets) + 30


def test_error_frames_are_counted() -> None:
    bench = Bench(CAN, {"kind": "error_frames", "rate": 50.0})
    counts = []
    for time_ms in (50, 100, 150, 200, 300, 400, 500):
        counts.append(bench.at(time_ms).service().link.counts["error_frames"])
    assert counts == [0, 0, 2, 5, 10, 10, 10]
    assert bench.line.sent == []


def test_what_comes_at_a_rate_comes_once_though_the_port_is_lost_meanwhile() -> None:
    bench = Bench(
        CAN,
        {"kind": "error_frames", "rate": 50.0},
        {"kind": "babble", "rate": 800.0},
        {"kind": "bus_off", "from_ns": 150 * MS, "to_ns": 160 * MS},
    )
    for time_ms in range(3000):
        bench.at(time_ms).service()
    assert [text for _, text in bench.reported()] == ["link broken: bus off by an injected fault", "reopened"]
    assert bench.link.counts["error_frames"] == 10
    frames = [frame for payload in bench.line.sent for frame in unpack_frames(payload)]
    noise = PortFault(1, "babble", 100 * MS, 300 * MS, 0, 800.0).noise(0, 160)
    assert b"".join(frame.data for frame in frames) == noise[: 8 * len(frames)]
    assert len(frames) == 19


def test_nothing_goes_wrong_before_the_start() -> None:
    line = Line()
    port = FaultyPort(line.open, SERIAL, lambda: START_NS)
    port.add({"number": 0, "kind": "disconnect", "from_ns": 0, "to_ns": None})
    link = Link(port)
    assert link.send(b"a", START_NS) is DeliveryStatus.SENT
    port.begin(START_NS)
    assert link.send(b"b", START_NS) is DeliveryStatus.DROPPED_BROKEN


def test_a_sound_port_passes_everything_on() -> None:
    bench = Bench(SERIAL, {"kind": "disconnect"})
    bench.line.arrived = [b"x"]
    checks: list[Callable[[], bool]] = [
        lambda: bench.link.receive(bench.now_ns) == b"x",
        lambda: bench.link.readable == [5],
        lambda: bench.link.writable == [5],
        lambda: bench.link.description == "line",
        lambda: not bench.link.pending,
    ]
    assert all(check() for check in checks)

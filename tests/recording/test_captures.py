"""Captures and logs of other people's making, and ours in their hands."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import can
import pytest

from lidar_emu.errors import InputError
from lidar_emu.recording.captures import (
    RAW_IP,
    RTAC_SERIAL,
    SOCKETCAN,
    Captured,
    PcapWriter,
    can_record,
    read_capture,
    serial_record,
    udp_record,
)
from lidar_emu.recording.traffic import Traffic, read_traffic, write_wire_file
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames

START_NS = 1_900_000_000_123_456_789
FRAMES = [
    Frame(0x123, b"\1\2\3"),
    Frame(0x1ABCDEF0, b"", is_extended=True),
    Frame(0x7FF, bytes(64), True, True),
]


def _needs(*tools: str) -> None:
    missing = [tool for tool in tools if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (Debian's tshark and wireshark-common)")


def _dissected(path: Path, *fields: str) -> list[list[str]]:
    """Fields of each record, by tshark."""
    options = [word for field in fields for word in ("-e", field)]
    done = subprocess.run(
        ["tshark", "-r", str(path), "-T", "fields", *options], capture_output=True, text=True, check=True
    )
    return [line.split("\t") for line in done.stdout.splitlines()]


def _write(path: Path, link_type: int, records: list[tuple[int, bytes]]) -> Path:
    with path.open("wb") as file:
        writer = PcapWriter(file, link_type)
        for time_ns, data in records:
            writer.write(time_ns, data)
    return path


def test_tshark_reads_can_frames(tmp_path: Path) -> None:
    _needs("tshark")
    frames = [*FRAMES, Frame(5, bytes(8), is_fd=True), Frame(6, bytes(8), is_fd=True, bitrate_switch=True)]
    path = _write(
        tmp_path / "w.pcap", SOCKETCAN, [(START_NS + k, can_record(f)) for k, f in enumerate(frames)]
    )
    rows = _dissected(path, "frame.time_epoch", "can.id", "can.flags.xtd", "canfd.flags.brs", "data.data")
    assert [row[0] for row in rows] == [f"1900000000.{123_456_789 + k}" for k in range(5)]
    assert [int(row[1], 0) for row in rows] == [frame.can_id for frame in frames]
    assert [row[2] in ("1", "True") for row in rows] == [frame.is_extended for frame in frames]
    assert [row[3] != "" for row in rows] == [frame.is_fd for frame in frames]
    assert [row[3] in ("1", "True") for row in rows] == [frame.bitrate_switch for frame in frames]
    assert [bytes.fromhex(row[4]) for row in rows] == [frame.data for frame in frames]


@pytest.mark.parametrize(
    ("to", "shown"),
    [
        ("127.0.0.1:5600", "127.0.0.1"),
        ("[::1]:5600", "::1"),
        ("[fe80::1]:7", "fe80::1"),
        ("lander:7", "0.0.0.0"),
    ],
)
def test_tshark_reads_datagrams(to: str, shown: str, tmp_path: Path) -> None:
    _needs("tshark")
    payloads = b"abc", b"defg", b"\1\x52"  # to fe80::1, the checksum of the last one would be 0
    path = _write(tmp_path / "w.pcap", RAW_IP, [(START_NS, udp_record(to, data)) for data in payloads])
    kind = "ipv6.dst" if ":" in shown else "ip.dst"
    rows = _dissected(path, kind, "udp.dstport", "udp.payload", "udp.checksum", "_ws.malformed")
    assert [row[:3] for row in rows] == [[shown, to.rpartition(":")[2], data.hex()] for data in payloads]
    assert ":" not in shown or all(int(row[3], 0) for row in rows), "0 says that there is no checksum"
    checked = subprocess.run(
        ["tshark", "-r", str(path), "-o", "udp.check_checksum:TRUE", "-o", "ip.check_checksum:TRUE", "-V"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "incorrect" not in checked.stdout


def test_tshark_reads_serial_bytes(tmp_path: Path) -> None:
    _needs("tshark")
    path = _write(tmp_path / "w.pcap", RTAC_SERIAL, [(START_NS, serial_record(START_NS, b"\0\1\2"))])
    ((time_s, event, data),) = _dissected(path, "frame.time_epoch", "rtacser.eventtype", "data.data")
    assert time_s == "1900000000.123456789"
    assert (int(event, 0), data) == (1, "000102")


@pytest.mark.parametrize("form", ["pcap", "nsecpcap", "pcapng"])
def test_captures_that_wireshark_has_written(form: str, tmp_path: Path) -> None:
    """Datagrams on Ethernet, from a hex dump by text2pcap; rewritten by editcap."""
    _needs("text2pcap", "editcap")
    datagrams = [bytes([k]) * (k + 1) for k in range(5)]
    dump = "".join(f"12:00:0{k}.250000\n000000 {data.hex(' ')}\n" for k, data in enumerate(datagrams))
    (tmp_path / "dump.txt").write_text(dump)
    made, path = tmp_path / "made", tmp_path / "c.cap"
    convert = ["text2pcap", "-q", "-t", "%H:%M:%S.", "-4", "10.0.0.1,10.0.0.2", "-u", "1000,5600"]
    subprocess.run([*convert, str(tmp_path / "dump.txt"), str(made)], check=True, capture_output=True)
    subprocess.run(["editcap", "-F", form, str(made), str(path)], check=True, capture_output=True)
    traffic = read_traffic(path)
    assert [payload for _, payload in traffic.packets] == datagrams
    assert [time_ns for time_ns, _ in traffic.packets] == [k * 10**9 for k in range(5)]
    assert not traffic.is_can


def test_big_endian_and_microseconds(tmp_path: Path) -> None:
    head = struct.pack(">IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 147)
    record = struct.pack(">IIII", 7, 500_001, 3, 3) + b"xyz"
    path = tmp_path / "c.pcap"
    path.write_bytes(head + record)
    assert list(read_capture(path)) == [Captured(147, 7_500_001_000, b"xyz")]
    assert read_traffic(path).packets == [(0, b"xyz")]


def _block(order: str, kind: int, body: bytes) -> bytes:
    """A block of pcapng: type and length before, length behind."""
    body += b"\0" * (-len(body) % 4)
    return struct.pack(f"{order}II", kind, len(body) + 12) + body + struct.pack(f"{order}I", len(body) + 12)


def _interface(order: str, link_type: int, **options: bytes) -> bytes:
    codes = {"resolution": 9, "offset": 14}
    body = struct.pack(f"{order}HHI", link_type, 0, 0)
    for name, value in options.items():
        padding = b"\0" * (-len(value) % 4)
        body += struct.pack(f"{order}HH", codes[name], len(value)) + value + padding
    return _block(order, 1, body)


def _record(order: str, interface: int, ticks: int, data: bytes) -> bytes:
    head = struct.pack(f"{order}IIIII", interface, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data))
    return _block(order, 6, head + data)


def _section(order: str) -> bytes:
    return _block(order, 0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))


def test_pcapng_times_and_link_types_are_those_of_each_interface(tmp_path: Path) -> None:
    path = tmp_path / "c.pcapng"
    big = ">"
    path.write_bytes(
        _section("<")
        + _interface("<", SOCKETCAN, resolution=b"\x09")
        + _interface("<", 147)
        + _record("<", 0, START_NS, b"abc")
        + _block("<", 5, bytes(12))  # statistics
        + _record("<", 1, START_NS // 1000, b"defgh")
        + _record("<", 2, 0, b"of no interface")
        + _section(big)
        + _interface(big, RTAC_SERIAL, resolution=b"\x8a", offset=struct.pack(">q", 1_900_000_000))
        + _record(big, 0, 3 * 1024 + 256, b"i")
    )
    assert list(read_capture(path)) == [
        Captured(SOCKETCAN, START_NS, b"abc"),
        Captured(147, START_NS // 1000 * 1000, b"defgh"),
        Captured(RTAC_SERIAL, 1_900_000_003_250_000_000, b"i"),
    ]


@pytest.mark.parametrize("lost", range(1, 40))
def test_a_truncated_pcapng_gives_the_records_before(lost: int, tmp_path: Path) -> None:
    path = tmp_path / "cut.pcapng"
    records = [_record("<", 0, k, bytes([k]) * 8) for k in range(4)]
    path.write_bytes(b"".join([_section("<"), _interface("<", 147), *records])[:-lost])
    kept = 4 - -(-lost // len(records[0]))
    assert [record.data for record in read_capture(path)] == [bytes([k]) * 8 for k in range(kept)]


@pytest.mark.parametrize("lost", range(1, 40))
def test_a_capture_that_was_cut_gives_what_was_before(lost: int, tmp_path: Path) -> None:
    whole = _write(tmp_path / "w.pcap", 147, [(START_NS + k, bytes([k]) * 10) for k in range(4)])
    cut = tmp_path / "cut.pcap"
    cut.write_bytes(whole.read_bytes()[:-lost])
    kept = 4 - -(-lost // 26)
    assert [payload for _, payload in read_traffic(cut).packets] == [bytes([k]) * 10 for k in range(kept)]


CANDUMP = """\
(1900000000.000000) can0 123#010203
(1900000000.500000) can0 12345678#
(1900000001.250000) can0 7FF##1000102030405060708090A0B
(1900000001.300000) can0 123#R
"""


def test_a_log_of_candump(tmp_path: Path) -> None:
    path = tmp_path / "c.log"
    path.write_text(CANDUMP)
    traffic = read_traffic(path)
    assert [round(time_ns / 1e6) for time_ns, _ in traffic.packets] == [0, 500, 1250]
    assert [f for _, payload in traffic.packets for f in unpack_frames(payload)] == [
        Frame(0x123, b"\1\2\3"),
        Frame(0x12345678, b"", is_extended=True),
        Frame(0x7FF, bytes(range(12)), True, True),
    ]
    assert traffic.left_out == {"other": 1}
    assert traffic.start_ns == 1_900_000_000 * 10**9


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_logs_that_python_can_reads_back(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"c{suffix}"
    packets = [(k * 250_000_000, pack_frames([frame])) for k, frame in enumerate(FRAMES)]
    write_wire_file(Traffic(packets, is_can=True, start_ns=START_NS), path)
    with can.LogReader(path) as reader:
        messages = [m for m in reader if not m.is_error_frame]
    assert [(m.arbitration_id, bytes(m.data), m.is_fd, m.is_extended_id) for m in messages] == [
        (frame.can_id, frame.data, frame.is_fd, frame.is_extended) for frame in FRAMES
    ]
    read = read_traffic(path)
    assert [f for _, payload in read.packets for f in unpack_frames(payload)] == FRAMES
    assert [round(time_ns / 1e6) for time_ns, _ in read.packets] == [0, 250, 500]


REFUSED = {
    "empty.pcap": (b"", "empty"),
    "text.txt": (b"hello", "not a recording"),
    "head.pcap": (struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 147), "no packet that was sent"),
    "half.pcap": (struct.pack("<I", 0xA1B23C4D), "no packet that was sent"),
    "half.pcapng": (b"\x0a\x0d\x0d\x0a\x1c\0\0\0", "no packet that was sent"),
    "huge.pcap": (
        struct.pack("<IHHiIIIIIII", 0xA1B23C4D, 2, 4, 0, 0, 0, 147, 0, 0, 2**31, 2**31),
        "no packet that was sent",
    ),
    "wifi.pcap": (
        struct.pack("<IHHiIIIIIII", 0xA1B23C4D, 2, 4, 0, 0, 0, 105, 0, 0, 1, 1) + b"x",
        r"link type: must be SocketCAN, .* \(got 105\)",
    ),
    "words.log": (b"hello\n", "not readable after 0 frames"),
    "empty.log": (b"\n", "no packet that was sent"),
    "bad.blf": (b"LOGG" + bytes(20), "not readable after 0 frames"),
    "two.log": (
        CANDUMP.replace("can0 7FF", "can1 7FF").encode(),
        r"traffic of several senders: can1 \(1\), can0 \(2\)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_replayed_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    content, found = REFUSED[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=found) as refusal:
        read_traffic(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)


def test_two_flows_are_distinguished(tmp_path: Path) -> None:
    records = [(START_NS, udp_record(f"127.0.0.1:{port}", b"x")) for port in (1, 2, 2)]
    with pytest.raises(
        InputError,
        match=r"udp to 127.0.0.1:1 \(1\), udp to 127.0.0.1:2 \(2\); select one, for example by: tshark",
    ):
        read_traffic(_write(tmp_path / "w.pcap", RAW_IP, records))


def test_garbage_on_every_link_is_passed_over(tmp_path: Path) -> None:
    good = udp_record("127.0.0.1:5", b"good")
    fragment = good[:6] + b"\x20\0" + good[8:]
    broken = [b"", b"\x45", good[:25], fragment, b"\x60" + good[1:], good[:9] + b"\x06" + good[10:]]
    records = [(START_NS + k, data) for k, data in enumerate([*broken, good])]
    traffic = read_traffic(_write(tmp_path / "w.pcap", RAW_IP, records))
    assert traffic.packets == [(0, b"good")]
    assert traffic.left_out == {"other": len(broken)}


def test_the_schedule_of_laps_and_speeds() -> None:
    traffic = Traffic([(-100, b"a"), (0, b"b"), (100, b"c"), (300, b"d")], False, 0)
    due = [(p.shot, p.due_ns, p.payload) for p in traffic.within(-1e-7, 2e-7).scheduled(0.5, 2)]
    assert due == [
        (0, 0, b"a"),
        (1, 200, b"b"),
        (2, 400, b"c"),
        (3, 600, b"a"),
        (4, 800, b"b"),
        (5, 1000, b"c"),
    ]
    assert next(iter(traffic.scheduled(1.0, None))).payload == b"a"
    with pytest.raises(InputError, match="--from: no packet"):
        traffic.within(1.0, None)

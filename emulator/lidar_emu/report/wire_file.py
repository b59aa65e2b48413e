"""Export of a link's traffic for other tools: a packet capture, a log of a CAN bus, or space packets."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import BinaryIO

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, whole_file
from lidar_emu.recording.captures import (
    RAW_IP,
    RTAC_SERIAL,
    SOCKETCAN,
    PcapWriter,
    can_record,
    serial_record,
    udp_record,
    write_log,
)
from lidar_emu.recording.traffic import Traffic
from lidar_emu.transports.frames import unpack_frames
from lidar_emu.transports.spec import Kind
from lidar_protocol.definitions import ByteLink
from lidar_protocol.framing import LinkCounters
from lidar_protocol.headers import SpacePacketHeader
from lidar_protocol.packet import check_length

_CAPTURE, _PACKETS, _LOGS = ".pcap", ".ccsds", (".log", ".asc", ".blf")
WIRE_SUFFIXES = (_CAPTURE, _PACKETS, *_LOGS)


def check_wire_file(path: Path, option: str = "--to") -> None:
    """Check the path of an export.

    Raises:
        InputError: the file cannot be written, or its suffix is unknown.
    """
    check_destination(path, option)
    if path.suffix.lower() not in WIRE_SUFFIXES:
        raise InputError(
            option,
            None,
            str(path),
            f"must end with {_CAPTURE}, {_PACKETS} or, for a CAN bus, {', '.join(_LOGS)}",
        )


def write_wire_file(traffic: Traffic, path: Path) -> str:
    """Write packets with their times in UTC, and return a line that says how many.

    A `.pcap` has nanosecond times, and holds SocketCAN frames, datagrams or the bytes of a serial line. `.log`, `.asc`
    and `.blf` hold the frames of a CAN bus. `.ccsds` holds space packets one after another, without framing and times;
    a packet that does not have the length that it states is left out, because no reader would find the next one.

    Raises:
        InputError: the file is a log of a CAN bus, and the traffic is not; or it is for space packets, and the traffic
            has none.
        RunError: writing failed.
    """
    suffix, count = path.suffix.lower(), len(traffic.packets)
    if suffix == _PACKETS:
        link = _link_of_space_packets(traffic, path)
        with whole_file(path) as file:
            whole = _write_packets(traffic, link, file)
        left_out = f", {count - whole} left out: damaged" if whole < count else ""
        return f"{path}: {whole} packets{left_out}"
    packets = ((traffic.start_ns + time_ns, payload) for time_ns, payload in traffic.packets)
    if suffix == _CAPTURE:
        with whole_file(path) as file:
            _write_capture(traffic, packets, file)
    elif traffic.is_can:
        write_log(path, packets)
    else:
        found = Finding("a log of a CAN bus for a run without one")
        raise InputError(str(path), None, found, f"write a file {_CAPTURE}")
    return f"{path}: {count} packets"


def _link_of_space_packets(traffic: Traffic, path: Path) -> ByteLink:
    if traffic.recording is None or traffic.is_can:
        found = Finding("traffic of CAN" if traffic.is_can else "a capture, which does not say its framing")
        raise InputError(str(path), None, found, "must be a recording of a byte link")
    link = traffic.recording.interface.link
    if not isinstance(link.header, SpacePacketHeader):
        raise InputError(
            str(path), None, Finding("packets with a custom header"), "must be a recording of space packets"
        )
    return link


def _write_packets(traffic: Traffic, link: ByteLink, file: BinaryIO) -> int:
    longest = max(len(payload) for _, payload in traffic.packets)
    reader = link.framing.reader(longest, partial(check_length, link), LinkCounters())
    return sum(file.write(packet) > 0 for _, payload in traffic.packets for packet in reader.receive(payload))


def _write_capture(traffic: Traffic, packets: Iterable[tuple[int, bytes]], file: BinaryIO) -> None:
    if traffic.is_can:
        writer = PcapWriter(file, SOCKETCAN)
        for time_ns, payload in packets:
            for frame in unpack_frames(payload):
                writer.write(time_ns, can_record(frame))
        return
    port = None if traffic.recording is None else traffic.recording.port
    if port is not None and port.kind is Kind.UDP:
        writer = PcapWriter(file, RAW_IP)
        for time_ns, payload in packets:
            writer.write(time_ns, udp_record(port.path, payload))
        return
    writer = PcapWriter(file, RTAC_SERIAL)
    for time_ns, payload in packets:
        writer.write(time_ns, serial_record(time_ns, payload))

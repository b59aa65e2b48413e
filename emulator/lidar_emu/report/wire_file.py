"""Export of a link's traffic for other tools: a packet capture, or a log of a CAN bus."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, whole_file
from lidar_emu.recording.can_log import write_log
from lidar_emu.recording.link_layers import (
    RAW_IP,
    RTAC_SERIAL,
    SOCKETCAN,
    can_record,
    serial_record,
    udp_record,
)
from lidar_emu.recording.pcap import PcapWriter
from lidar_emu.recording.traffic import Traffic
from lidar_emu.transports.frames import unpack_frames
from lidar_emu.transports.spec import Kind

_CAPTURE, _LOGS = ".pcap", (".log", ".asc", ".blf")
WIRE_SUFFIXES = (_CAPTURE, *_LOGS)


def check_wire_file(path: Path, option: str = "--to") -> None:
    """Check the path of an export.

    Raises:
        InputError: the file cannot be written, or its suffix is unknown.
    """
    check_destination(path, option)
    if path.suffix.lower() not in WIRE_SUFFIXES:
        raise InputError(
            option, None, str(path), f"allowed: a file {_CAPTURE}, and for a CAN bus {', '.join(_LOGS)}"
        )


def write_wire_file(traffic: Traffic, path: Path) -> None:
    """Write packets with their times in UTC.

    A `.pcap` has nanosecond times, and holds SocketCAN frames, datagrams or the bytes of a serial line. `.log`, `.asc`
    and `.blf` hold the frames of a CAN bus.

    Raises:
        InputError: the file is a log of a CAN bus, and the traffic is not.
        RunError: writing failed.
    """
    packets = ((traffic.start_ns + time_ns, payload) for time_ns, payload in traffic.packets)
    if path.suffix.lower() == _CAPTURE:
        with whole_file(path) as file:
            _write_capture(traffic, packets, file)
        return
    if not traffic.is_can:
        found = Finding("a log of a CAN bus for a run without one")
        raise InputError(str(path), None, found, f"allowed: a file {_CAPTURE}")
    write_log(path, packets)


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

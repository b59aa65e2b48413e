"""Traffic of a link: from a recording, a packet capture or a log of a CAN bus, and its export for other tools."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_destination, whole_file
from lidar_emu.recording import channels
from lidar_emu.recording.captures import (
    LOG_SUFFIXES,
    MAGICS,
    NEXT_GENERATION_MAGIC,
    RAW_IP,
    RTAC_SERIAL,
    SOCKETCAN,
    PcapWriter,
    can_record,
    decode_record,
    is_known,
    read_capture,
    read_log,
    serial_record,
    udp_record,
    write_log,
)
from lidar_emu.recording.mcap_file import MAGIC as MCAP_MAGIC
from lidar_emu.recording.mcap_file import first_bytes
from lidar_emu.recording.read import Recording, read_recording
from lidar_emu.runtime.port.packets import DeliveryStatus, OutgoingPacket
from lidar_emu.transports.frames import unpack_frames
from lidar_emu.transports.spec import Kind
from lidar_protocol.definitions import ByteLink
from lidar_protocol.framing import LinkCounters
from lidar_protocol.headers import SpacePacketHeader
from lidar_protocol.packet import check_length

_READABLE = (
    f"must be a recording of lidar-emu (.mcap), a capture (.pcap, .pcapng), or a log of a CAN bus "
    f"({', '.join(LOG_SUFFIXES)})"
)


@dataclass(frozen=True)
class Traffic:
    """Packets with their times, in ascending order of time."""

    packets: list[tuple[int, bytes]]
    """Nanoseconds from the start, and bytes; on CAN frame records."""
    is_can: bool
    start_ns: int
    """Since 1970."""
    left_out: dict[str, int] = field(default_factory=dict)
    """Number of other records, by kind: packets that were not sent, and records that cannot be sent."""
    recording: Recording | None = None
    """Source of the traffic, if it is a recording of a run."""

    @property
    def span_ns(self) -> int:
        """Time from the first packet to the last."""
        return self.packets[-1][0] - self.packets[0][0]

    def within(self, from_s: float | None, until_s: float | None) -> Traffic:
        """Traffic in the interval [from_s, until_s), in seconds from the start.

        Raises:
            InputError: the interval holds no packet.
        """
        first_ns = self.packets[0][0] if from_s is None else round(from_s * 1e9)
        end_ns = self.packets[-1][0] + 1 if until_s is None else round(until_s * 1e9)
        kept = [packet for packet in self.packets if first_ns <= packet[0] < end_ns]
        if not kept:
            first_s, last_s = self.packets[0][0] * 1e-9, self.packets[-1][0] * 1e-9
            found = Finding(f"no packet from {first_ns * 1e-9:g} s until {end_ns * 1e-9:g} s")
            remedy = f"must overlap the packets, {first_s:.3f} s to {last_s:.3f} s"
            raise InputError("--from" if from_s is not None else "--until", None, found, remedy)
        return replace(self, packets=kept)

    def scheduled(self, speed: float = 1.0, laps: int | None = 1) -> Iterator[OutgoingPacket]:
        """Packets with their due times, counted from the first packet.

        Args:
            speed: time scale, e.g. 2.0 for twice as fast.
            laps: number of repetitions; None: endless. A lap lasts one mean packet interval longer than the traffic.
        """
        first_ns, count = self.packets[0][0], len(self.packets)
        lap_ns = self.span_ns + (self.span_ns // (count - 1) if count > 1 else 10**9)
        lap = number = 0
        while laps is None or lap < laps:
            for time_ns, payload in self.packets:
                yield OutgoingPacket(number, round((lap * lap_ns + time_ns - first_ns) / speed), payload)
                number += 1
            lap += 1


def read_traffic(path: Path, as_sent: bool = False) -> Traffic:
    """Read the traffic of a file.

    Args:
        path: recording, capture, or log of a CAN bus.
        as_sent: use the times of transmission of a run's shots instead of their due times.

    Raises:
        InputError: the file cannot be read, has another format, or holds no traffic, or traffic of several links.
    """
    magic = first_bytes(path, _READABLE)
    if magic == MCAP_MAGIC:
        traffic = _from_recording(read_recording(path), as_sent)
    elif magic[:4] in (*MAGICS, NEXT_GENERATION_MAGIC):
        traffic = _from_capture(path)
    elif path.suffix.lower() in LOG_SUFFIXES:
        traffic = _from_log(path)
    else:
        raise InputError(str(path), None, Finding("not a recording" if magic else "empty"), _READABLE)
    if not traffic.packets:
        left_out = ", ".join(f"{name} {count}" for name, count in traffic.left_out.items())
        found = Finding("no packet that was sent" + (f" ({left_out})" if left_out else ""))
        raise InputError(str(path), None, found, "must be a file with packets that were sent")
    return traffic


def _from_recording(recording: Recording, as_sent: bool) -> Traffic:
    """Packets that were sent; late, dropped and suppressed ones were not on the link."""
    packets = recording.packets()
    by_clock = as_sent and recording.origin.get("pace") == "wall"
    sent = packets.status == DeliveryStatus.SENT
    times_ns = (packets.sent_ns if by_clock else packets.due_ns)[sent].tolist()
    payloads = [payload for payload, was_sent in zip(packets.payload, sent, strict=True) if was_sent]
    # Where a record is damaged, a delivery may be left without its packet.
    shots = [each for each in zip(times_ns, payloads, strict=True) if each[1]]
    between = [
        *recording.raw_messages(channels.HOUSEKEEPING),
        *recording.raw_messages(channels.ACKNOWLEDGEMENT),
    ]
    recording.warn_of_damage()
    # The sort is stable: housekeeping that is due with a shot follows it.
    ordered = sorted([*shots, *between], key=itemgetter(0))
    unsent = {
        DeliveryStatus(code).name.lower(): int((packets.status == code).sum())
        for code in DeliveryStatus
        if code not in (DeliveryStatus.SENT, DeliveryStatus.HELD)
    }
    return Traffic(
        [(int(time_ns), payload) for time_ns, payload in ordered],
        recording.port.kind is Kind.CAN,
        round(recording.started_utc.timestamp() * 1e6) * 1000,
        {name: count for name, count in unsent.items() if count},
        recording,
    )


def _from_capture(path: Path) -> Traffic:
    packets: list[tuple[int, bytes]] = []
    flows: dict[str, int] = {}
    ignored = 0
    unknown: set[int] = set()
    is_can = False
    for link_type, time_ns, data in read_capture(path):
        content = decode_record(link_type, data)
        if content is None or not content.payload:
            ignored += 1
            if not is_known(link_type):
                unknown.add(link_type)
            continue
        flows[content.flow] = flows.get(content.flow, 0) + 1
        is_can = content.is_can
        packets.append((time_ns, content.payload))
    if unknown and not packets:
        remedy = "must be SocketCAN, RTAC serial, UDP over IP or Ethernet, bytes as user type 0 to 15"
        raise InputError(str(path), "link type", unknown.pop(), remedy)
    _refuse_several(path, flows, "for example by: tshark -r ALL.pcap -Y udp.dstport==5600 -w ONE.pcap")
    return _from_first(packets, is_can, ignored)


def _from_log(path: Path) -> Traffic:
    packets, buses, ignored = read_log(path)
    _refuse_several(path, buses, "for example by: grep vcan0 ALL.log > ONE.log")
    return _from_first(packets, True, ignored)


def _from_first(packets: list[tuple[int, bytes]], is_can: bool, ignored: int) -> Traffic:
    start_ns = min((time_ns for time_ns, _ in packets), default=0)
    ordered = sorted(((time_ns - start_ns, payload) for time_ns, payload in packets), key=itemgetter(0))
    return Traffic(ordered, is_can, start_ns, {"other": ignored} if ignored else {})


def _refuse_several(path: Path, flows: dict[str, int], how: str) -> None:
    """Refuse traffic of more than one sender: a device has one link, and only its own traffic is replayed."""
    if len(flows) > 1:
        names = ", ".join(f"{name} ({count})" for name, count in sorted(flows.items(), key=itemgetter(1)))
        raise InputError(
            str(path), None, Finding(f"traffic of several senders: {names}"), f"select one, {how}"
        )


_CAPTURE, _PACKETS, _LOGS = ".pcap", ".ccsds", (".log", ".asc", ".blf")
WIRE_SUFFIXES = (_CAPTURE, _PACKETS, *_LOGS)


def check_wire_file(path: Path, option: str = "--to") -> None:
    """Check the path of an export.

    Raises:
        InputError: the file cannot be written, or its suffix is unknown.
    """
    check_destination(path, option)
    if path.suffix.lower() not in WIRE_SUFFIXES:
        remedy = f"must end with {_CAPTURE}, {_PACKETS} or, for a CAN bus, {', '.join(_LOGS)}"
        raise InputError(option, None, str(path), remedy)


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
    port = None if traffic.recording is None else traffic.recording.port
    records: Iterable[tuple[int, bytes]]
    if traffic.is_can:
        frames = ((time_ns, frame) for time_ns, payload in packets for frame in unpack_frames(payload))
        link_type, records = SOCKETCAN, ((time_ns, can_record(frame)) for time_ns, frame in frames)
    elif port is not None and port.kind is Kind.UDP:
        path = port.path
        link_type, records = RAW_IP, ((time_ns, udp_record(path, payload)) for time_ns, payload in packets)
    else:
        link_type, records = RTAC_SERIAL, ((at_ns, serial_record(at_ns, data)) for at_ns, data in packets)
    writer = PcapWriter(file, link_type)
    for record in records:
        writer.write(*record)

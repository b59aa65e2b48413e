"""Recorded link traffic: from a recording of a run, a packet capture or a log of a CAN bus."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path

from lidar_emu.errors import Finding, InputError
from lidar_emu.recording import channels
from lidar_emu.recording.captures import (
    LOG_SUFFIXES,
    MAGICS,
    NEXT_GENERATION_MAGIC,
    decode_record,
    is_known,
    read_capture,
    read_log,
)
from lidar_emu.recording.mcap_file import MAGIC as MCAP_MAGIC
from lidar_emu.recording.mcap_file import first_bytes
from lidar_emu.recording.read import Recording, read_recording
from lidar_emu.runtime.port.packets import DeliveryStatus, OutgoingPacket
from lidar_emu.transports.spec import Kind

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

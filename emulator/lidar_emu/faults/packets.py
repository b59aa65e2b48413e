"""Faults of packets: effects on encoded packets, and the encoder with the faults of packets and of their contents."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from lidar_emu.device.state import Status
from lidar_emu.errors import Finding, InputError
from lidar_emu.faults import indexed_faults
from lidar_emu.faults.beams import extended
from lidar_emu.faults.packet_contents import REWRITING, ContentFaults, ContentState, Rewriter
from lidar_emu.faults.schedule import FaultOccurrence, FaultSchedule
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.random_streams import RandomStream, fault_purpose
from lidar_emu.scenario.faults import ContentFault, DeviceFault, LinkFault, PacketFault
from lidar_emu.scenario.faults import packets as kinds
from lidar_emu.scenario.schema import Scenario
from lidar_emu.wire import Encoder, Packet
from lidar_protocol import CanFrame, DecodeError, Interface

Piece = bytes | CanFrame
"""Unit that a fault acts on: a framed packet, or a CAN frame."""

Pieces = tuple[Piece, ...]

_Fault = PacketFault | LinkFault | DeviceFault
"""Faults of the port and of the device act elsewhere; only their occurrences are reported here."""

_CAN_DATA_BYTES = 8
_CAN_IDS = 0x800
_RECORD_BYTES = 14
_NUMBERS_AT_ONCE = 64
_DOUBLING = (kinds.Doubled, kinds.Reordered)
_MAXIMUM_DOUBLING = 6


class PacketState(NamedTuple):
    """State of the faults of packets, passed from shot to shot."""

    held: tuple[Pieces, ...]
    """For each fault, the packet that it holds back, or the last packet before it."""
    last_due_ns: int = 0


class WireState(NamedTuple):
    """State of the faults of contents and packets, passed from shot to shot."""

    contents: ContentState
    packets: PacketState


class FaultyPackets(NamedTuple):
    """Packets of consecutive shots after their faults."""

    packets: list[Packet]
    """One for each shot; empty if suppressed or held back."""
    due_ns: list[int]
    """Due times, ascending."""
    held: frozenset[int]
    """Shots whose packet is held back, and sent with the next one."""
    faults: list[FaultOccurrence]
    """Faults that acted on these shots."""


@dataclass(frozen=True)
class _ActivePacketFault:
    fault: Any
    stream: RandomStream
    shot: int
    interface: Interface
    rewriter: Rewriter
    can: bool


def _truncated(pieces: Pieces, active: _ActivePacketFault) -> Pieces:
    if active.can:
        return pieces[: int(active.fault.keep * len(pieces))]
    whole = b"".join(piece for piece in pieces if isinstance(piece, bytes))
    return (whole[: int(active.fault.keep * len(whole))],)


def _bit_errors(pieces: Pieces, active: _ActivePacketFault) -> Pieces:
    errors = _inverted_bits(active)
    place, first, result = next(errors), 0, list[Piece]()
    for piece in pieces:
        data = bytearray(piece.data if isinstance(piece, CanFrame) else piece)
        while place < first + 8 * len(data):
            data[(place - first) // 8] ^= 0x80 >> (place - first) % 8
            place = next(errors)
        first += 8 * len(data)
        result.append(piece._replace(data=bytes(data)) if isinstance(piece, CanFrame) else bytes(data))
    return tuple(result)


def _inverted_bits(active: _ActivePacketFault) -> Iterator[int]:
    place, drawn = -1, 0
    log_good = math.log1p(-active.fault.rate) if active.fault.rate < 1 else -math.inf
    while True:
        for u in active.stream.sequence(active.shot, drawn, _NUMBERS_AT_ONCE).tolist():
            place += 1 + int(math.log(u) / log_good)
            yield place
        drawn += _NUMBERS_AT_ONCE


def _wrong_crc(pieces: Pieces, active: _ActivePacketFault) -> Pieces:
    return tuple(_with_wrong_crc(piece, active.interface) for piece in pieces if isinstance(piece, bytes))


def _with_wrong_crc(frame: bytes, interface: Interface) -> bytes:
    """Invert the last byte of the packet, part of the CRC; bytes that are no longer a frame are left unchanged."""
    framing = interface.link.framing
    try:
        packet = framing.packet_of(frame)
    except DecodeError:
        return frame
    return framing.with_packet(frame, packet[:-1] + bytes(byte ^ 0xFF for byte in packet[-1:]))


def _rewritten(pieces: Pieces, active: _ActivePacketFault) -> Pieces:
    return tuple(
        active.rewriter.frame(piece, active.fault)
        if isinstance(piece, CanFrame)
        else active.rewriter.packet(piece, active.fault)
        for piece in pieces
    )


def _garbage(pieces: Pieces, active: _ActivePacketFault) -> Pieces:
    count = active.fault.bytes
    noise = bytes(int(u * 256) for u in active.stream.sequence(active.shot, 0, count).tolist())
    if not active.can:
        return (noise, *pieces)
    blocks = [noise[k : k + _CAN_DATA_BYTES] for k in range(0, count, _CAN_DATA_BYTES)]
    places = active.stream.sequence(active.shot, count, len(blocks)).tolist()
    frames = [CanFrame(int(u * _CAN_IDS), data) for u, data in zip(places, blocks, strict=True)]
    return (*frames, *pieces)


_EFFECTS: dict[type, Callable[[Pieces, _ActivePacketFault], Pieces]] = {
    kinds.Lost: lambda _pieces, _active: (),
    kinds.Doubled: lambda pieces, _active: pieces + pieces,
    kinds.BitErrors: _bit_errors,
    kinds.Truncated: _truncated,
    kinds.WrongCrc: _wrong_crc,
    kinds.Silence: lambda _pieces, _active: (),
    kinds.Garbage: _garbage,
    **dict.fromkeys(REWRITING, _rewritten),
}
"""Effects of faults without state."""


class FaultyEncoder:
    """An encoder with faults of packet contents and packets; of faults of the link and of the device only occurrences
    are reported.

    Args:
        scenario: scenario with the faults.
        encoder: encoder without faults.
        can: whether the link is a CAN bus.

    Raises:
        InputError: a fault does not apply to this link, or too many faults double the length of packets.
    """

    def __init__(self, scenario: Scenario, encoder: Encoder, can: bool) -> None:
        seed, period_ns = scenario.seed, scenario.timing.period_ns
        self._encoder, self._interface, self._can = encoder, encoder.interface, can
        self._rewriter = Rewriter(self._interface)
        self._contents = ContentFaults(indexed_faults(scenario, ContentFault), seed, period_ns)
        self._faults: list[tuple[int, _Fault, FaultSchedule, RandomStream]] = []
        for index, fault in indexed_faults(scenario, _Fault):
            if isinstance(fault, kinds.WrongCrc) and (can or self._interface.link.crc is None):
                found = Finding("wrong_crc on CAN" if can else "no CRC in this interface")
                remedy = "use a byte link, and an interface that has a CRC"
                raise InputError(scenario.name, f"faults.{index}.kind", found, remedy)
            if (needed := self._rewriter.refusal(fault, can)) is not None:
                found = Finding(f"{fault.kind} with interface {self._interface.name}")
                raise InputError(scenario.name, f"faults.{index}", found, f"use {needed}")
            stream = RandomStream(seed, fault_purpose(index))
            self._faults.append((index, fault, FaultSchedule(fault, stream, period_ns), stream))
        doubling = sum(isinstance(fault, _DOUBLING) for _, fault, *_ in self._faults)
        if doubling > _MAXIMUM_DOUBLING:
            found = Finding(f"{doubling} of kind doubled or reordered")
            remedy = f"must be {_MAXIMUM_DOUBLING}, each of which can double a packet"
            raise InputError(scenario.name, "faults", found, remedy)
        self.initial = WireState(self._contents.initial, PacketState(((),) * len(self._faults)))
        """State before shot 0."""

    def packets(
        self, measurement: Measurement, stamped: Measurement, status: Status, state: WireState
    ) -> tuple[FaultyPackets, WireState]:
        """Encode consecutive shots.

        Args:
            measurement: measurement of the shots.
            stamped: the same with the shot numbers and times of the device's counter and clock.
            status: status of the device during these shots.
            state: state after the shots before.

        Returns:
            The packets, with all faults of their contents, and the state after the shots.
        """
        contents, after_contents, in_contents = stamped, state.contents, list[FaultOccurrence]()
        if not status.silent:
            contents, after_contents, in_contents = self._contents.apply(
                measurement.shot, stamped, state.contents
            )
        finished = list(self._encoder.packets(contents, status))
        sent, after_packets = self._sent(measurement, finished, state.packets, status.silent)
        return sent._replace(faults=in_contents + sent.faults), WireState(after_contents, after_packets)

    def extended(self, state: WireState | None) -> WireState:
        """State of the first of these faults, extended by the initial state of the faults added behind them."""
        if state is None:
            return self.initial
        held = extended(state.packets.held, self.initial.packets.held)
        return WireState(extended(state.contents, self.initial.contents), state.packets._replace(held=held))

    def _sent(
        self, measurement: Measurement, packets: list[Packet], state: PacketState, silent: bool
    ) -> tuple[FaultyPackets, PacketState]:
        shot, never = measurement.shot, [False] * len(measurement)
        # A silent device sends no packets: faults of packets do not act, but one that was held back is sent.
        active = [
            never if silent and isinstance(fault, kinds.PacketFault) else schedule.active_shots(shot).tolist()
            for _, fault, schedule, _ in self._faults
        ]
        sent: list[Packet] = []
        due: list[int] = []
        held = set[int]()
        occurrences: list[FaultOccurrence] = []
        numbered = zip(shot.tolist(), measurement.due_ns.tolist(), strict=True)
        for row, (number, due_at_ns) in enumerate(numbered):
            active_now = [shots[row] for shots in active]
            pieces, state, acted = self._one(number, packets[row], active_now, state)
            delay_ns = sum(
                round(fault.delay_s * 1e9)
                for (_, fault, *_), now in zip(self._faults, active_now, strict=True)
                if now and isinstance(fault, kinds.Delayed)
            )
            state = state._replace(last_due_ns=max(state.last_due_ns, due_at_ns + delay_ns))
            sent.append(self._packet(pieces))
            if self._holds(state):
                held.add(number)
            due.append(state.last_due_ns)
            occurrences += [
                FaultOccurrence(number, index, fault.kind, ())
                for (index, fault, *_), did in zip(self._faults, acted, strict=True)
                if did
            ]
        return FaultyPackets(sent, due, frozenset(held), occurrences), state

    def _holds(self, state: PacketState) -> bool:
        """Whether a packet is held back after a shot; it is that shot's: the next shot's packet follows at once."""
        return any(
            kept and isinstance(fault, kinds.Reordered)
            for (_, fault, *_), kept in zip(self._faults, state.held, strict=True)
        )

    def longest(self, packet_bytes: int) -> int:
        """Greatest length in bytes of a packet after faults, if it has `packet_bytes` before them."""
        for _, fault, *_ in self._faults:
            if isinstance(fault, _DOUBLING):
                packet_bytes *= 2
            elif isinstance(fault, kinds.Garbage):
                packet_bytes += fault.bytes * (_RECORD_BYTES if self._can else 1)
        return packet_bytes

    def _one(
        self, shot: int, packet: Packet, active: list[bool], state: PacketState
    ) -> tuple[Pieces, PacketState, list[bool]]:
        """Packet of a shot after its faults, the state after it, and which faults acted: bit errors may hit no bit."""
        pieces: Pieces = (packet,) if isinstance(packet, bytes) else tuple(packet)
        held: list[Pieces] = []
        acted: list[bool] = []
        for (_, fault, _, stream), now, before in zip(self._faults, active, state.held, strict=True):
            kept: Pieces = ()
            did = now
            if isinstance(fault, kinds.Reordered):
                pieces, kept = ((), pieces) if now and not before else (pieces + before, ())
            elif isinstance(fault, kinds.StalePacket):
                pieces = before if now and before else pieces
                kept = pieces if any(pieces) else before
            elif now and type(fault) in _EFFECTS:
                acting = _ActivePacketFault(fault, stream, shot, self._interface, self._rewriter, self._can)
                whole, pieces = pieces, _EFFECTS[type(fault)](pieces, acting)
                did = pieces != whole
            held.append(kept)
            acted.append(did)
        return pieces, state._replace(held=tuple(held)), acted

    def _packet(self, pieces: Pieces) -> Packet:
        if self._can:
            return [piece for piece in pieces if isinstance(piece, CanFrame)]
        return b"".join(piece for piece in pieces if isinstance(piece, bytes))


def faulty_encoder(scenario: Scenario, encoder: Encoder, can: bool) -> FaultyEncoder | None:
    """Encoder with the scenario's faults; None if none of them concerns packets, link or device.

    Raises:
        InputError: a fault does not apply to this link.
    """
    faults = indexed_faults(scenario, ContentFault) + indexed_faults(scenario, _Fault)
    return FaultyEncoder(scenario, encoder, can) if faults else None

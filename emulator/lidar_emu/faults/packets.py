"""Faults of packets, of what stamps them and of the link: what they make of finished packets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.faults.interface_mismatch import REWRITING, Rewriter
from lidar_emu.faults.schedule import FaultOccurrence, FaultSchedule
from lidar_emu.numerics.random_streams import RandomStream, fault_purpose
from lidar_emu.scenario import faults as kinds
from lidar_protocol import CanFrame, DecodeError, Interface
from lidar_protocol.framing import Stuffed

Piece = bytes | CanFrame
"""What a fault handles as one: a framed packet, or a frame."""

Pieces = tuple[Piece, ...]

Packet = bytes | list[CanFrame]

_Fault = kinds.PacketFault | kinds.LinkFault | kinds.DeviceFault

_CAN_DATA_BYTES = 8
_CAN_IDS = 0x800
_RECORD_BYTES = 14
_NUMBERS_AT_ONCE = 64
_DOUBLING = (kinds.Doubled, kinds.Reordered)
_MOST_DOUBLING = 6


class PacketState(NamedTuple):
    """What is carried from shot to shot."""

    held: tuple[Pieces, ...]
    """By each fault: a packet that is held back, or the last good one."""
    last_due_ns: int = 0


@dataclass(frozen=True)
class _Act:
    """A fault in one shot."""

    fault: Any
    stream: RandomStream
    shot: int
    interface: Interface
    rewriter: Rewriter
    can: bool


class PacketFaults:
    """All faults of packets; those of the port and of the device are told of only.

    Args:
        numbered: the faults, with their places in the scenario's list.
        seed: of the run.
        period_ns: from shot to shot.
        interface: by which packets are made.
        can: whether the link is a CAN bus.
        name: of the scenario, for complaints.

    Raises:
        InputError: a fault is none of this link, or packets could grow without measure.
    """

    def __init__(
        self,
        numbered: Sequence[tuple[int, _Fault]],
        seed: int,
        period_ns: int,
        interface: Interface,
        can: bool,
        name: str,
    ) -> None:
        self._interface = interface
        self._rewriter = Rewriter(interface)
        self._can = can
        self._faults: list[tuple[int, _Fault, FaultSchedule, RandomStream]] = []
        for number, fault in numbered:
            if isinstance(fault, kinds.WrongCrc) and (can or interface.link.crc is None):
                found = Finding("wrong_crc on CAN" if can else "no CRC in this interface")
                allowed = "allowed: on a byte link with an interface that has a CRC"
                raise InputError(name, f"faults.{number}.kind", found, allowed)
            if (allowed_here := self._rewriter.refusal(fault, can)) is not None:
                found = Finding(f"{fault.kind} with interface {interface.name}")
                raise InputError(name, f"faults.{number}", found, f"allowed: {allowed_here}")
            stream = RandomStream(seed, fault_purpose(number))
            self._faults.append((number, fault, FaultSchedule(fault, stream, period_ns), stream))
        doubling = sum(isinstance(fault, _DOUBLING) for _, fault, *_ in self._faults)
        if doubling > _MOST_DOUBLING:
            found = Finding(f"{doubling} of kind doubled or reordered")
            raise InputError(
                name, "faults", found, f"allowed: {_MOST_DOUBLING}, each of which can double a packet"
            )
        self.initial = PacketState(((),) * len(self._faults))
        """What is carried before shot 0."""

    def apply(
        self,
        shot: NDArray[np.int64],
        due_ns: NDArray[np.int64],
        packets: list[Packet],
        state: PacketState,
        silent: bool = False,
    ) -> tuple[list[Packet], list[int], PacketState, list[FaultOccurrence]]:
        """What becomes of the packets of consecutive shots.

        Args:
            shot: (shots,) their numbers.
            due_ns: (shots,) when they are due.
            packets: of each, empty ones if `silent`.
            state: carried from the shots before.
            silent: whether the device sends none, so that there is nothing for faults of packets to act on. What was
                held back follows all the same.

        Returns:
            for each shot what is sent, perhaps nothing; and when, in ascending order; what is carried on; and which
            faults acted.
        """
        nowhere = [False] * len(shot)
        acts = [
            nowhere if silent and isinstance(fault, kinds.PacketFault) else schedule.shots(shot).tolist()
            for _, fault, schedule, _ in self._faults
        ]
        sent: list[Packet] = []
        due: list[int] = []
        injected: list[FaultOccurrence] = []
        for row, (number, due_at_ns) in enumerate(zip(shot.tolist(), due_ns.tolist(), strict=True)):
            acting = [act[row] for act in acts]
            pieces, state = self._one(number, packets[row], acting, state)
            delay_ns = sum(
                round(fault.delay_s * 1e9)
                for (_, fault, *_), now in zip(self._faults, acting, strict=True)
                if now and isinstance(fault, kinds.Delayed)
            )
            state = state._replace(last_due_ns=max(state.last_due_ns, due_at_ns + delay_ns))
            sent.append(self._packet(pieces))
            due.append(state.last_due_ns)
            injected += [
                FaultOccurrence(number, place, fault.kind, ())
                for (place, fault, *_), now in zip(self._faults, acting, strict=True)
                if now
            ]
        return sent, due, state, injected

    def longest(self, packet_bytes: int) -> int:
        """Of a packet, as the port takes it, that was so long before faults."""
        for _, fault, *_ in self._faults:
            if isinstance(fault, _DOUBLING):
                packet_bytes *= 2
            elif isinstance(fault, kinds.Garbage):
                packet_bytes += fault.bytes * (_RECORD_BYTES if self._can else 1)
        return packet_bytes

    def _one(
        self, shot: int, packet: Packet, acting: list[bool], state: PacketState
    ) -> tuple[Pieces, PacketState]:
        pieces: Pieces = (packet,) if isinstance(packet, bytes) else tuple(packet)
        held: list[Pieces] = []
        for (_, fault, _, stream), now, before in zip(self._faults, acting, state.held, strict=True):
            kept: Pieces = ()
            if isinstance(fault, kinds.Reordered):
                pieces, kept = ((), pieces) if now and not before else (pieces + before, ())
            elif isinstance(fault, kinds.StalePacket):
                pieces = before if now and before else pieces
                kept = pieces if any(pieces) else before
            elif now and type(fault) in _EFFECTS:
                act = _Act(fault, stream, shot, self._interface, self._rewriter, self._can)
                pieces = _EFFECTS[type(fault)](pieces, act)
            held.append(kept)
        return pieces, state._replace(held=tuple(held))

    def _packet(self, pieces: Pieces) -> Packet:
        if self._can:
            return [piece for piece in pieces if isinstance(piece, CanFrame)]
        return b"".join(piece for piece in pieces if isinstance(piece, bytes))


def _nothing(pieces: Pieces, act: _Act) -> Pieces:  # noqa: ARG001
    return ()


def _doubled(pieces: Pieces, act: _Act) -> Pieces:  # noqa: ARG001
    return pieces + pieces


def _truncated(pieces: Pieces, act: _Act) -> Pieces:
    if act.can:
        return pieces[: int(act.fault.keep * len(pieces))]
    whole = b"".join(piece for piece in pieces if isinstance(piece, bytes))
    return (whole[: int(act.fault.keep * len(whole))],)


def _bit_errors(pieces: Pieces, act: _Act) -> Pieces:
    errors = _error_places(act)
    place, first, result = next(errors), 0, list[Piece]()
    for piece in pieces:
        data = bytearray(_data(piece))
        while place < first + 8 * len(data):
            data[(place - first) // 8] ^= 0x80 >> (place - first) % 8
            place = next(errors)
        first += 8 * len(data)
        result.append(_with_data(piece, bytes(data)))
    return tuple(result)


def _error_places(act: _Act) -> Iterator[int]:
    """Numbers of the bits that are inverted: from one to the next the distance is geometric."""
    place, drawn = -1, 0
    log_good = math.log1p(-act.fault.rate) if act.fault.rate < 1 else -math.inf
    while True:
        for u in act.stream.sequence(act.shot, drawn, _NUMBERS_AT_ONCE).tolist():
            place += 1 + int(math.log(u) / log_good)
            yield place
        drawn += _NUMBERS_AT_ONCE


def _data(piece: Piece) -> bytes:
    return piece.data if isinstance(piece, CanFrame) else piece


def _with_data(piece: Piece, data: bytes) -> Piece:
    return piece._replace(data=data) if isinstance(piece, CanFrame) else data


def _wrong_crc(pieces: Pieces, act: _Act) -> Pieces:
    return tuple(_with_wrong_crc(piece, act.interface) for piece in pieces if isinstance(piece, bytes))


def _with_wrong_crc(frame: bytes, interface: Interface) -> bytes:
    """The last byte of the packet, which belongs to the CRC, inverted; what is no frame any more stays."""
    framing = interface.link.framing
    if not isinstance(framing, Stuffed):
        return _last_inverted(frame)
    try:
        packet = framing.decode(frame.strip(framing.delimiter))
    except DecodeError:
        return frame
    return framing.encode(_last_inverted(packet))


def _last_inverted(data: bytes) -> bytes:
    return data[:-1] + bytes(byte ^ 0xFF for byte in data[-1:])


def _rewritten(pieces: Pieces, act: _Act) -> Pieces:
    return tuple(
        act.rewriter.frame(piece, act.fault)
        if isinstance(piece, CanFrame)
        else act.rewriter.packet(piece, act.fault)
        for piece in pieces
    )


def _garbage(pieces: Pieces, act: _Act) -> Pieces:
    count = act.fault.bytes
    noise = bytes(int(u * 256) for u in act.stream.sequence(act.shot, 0, count).tolist())
    if not act.can:
        return (noise, *pieces)
    blocks = [noise[k : k + _CAN_DATA_BYTES] for k in range(0, count, _CAN_DATA_BYTES)]
    places = act.stream.sequence(act.shot, count, len(blocks)).tolist()
    frames = [CanFrame(int(u * _CAN_IDS), data) for u, data in zip(places, blocks, strict=True)]
    return (*frames, *pieces)


_EFFECTS: dict[type, Callable[[Pieces, _Act], Pieces]] = {
    kinds.Lost: _nothing,
    kinds.Doubled: _doubled,
    kinds.BitErrors: _bit_errors,
    kinds.Truncated: _truncated,
    kinds.WrongCrc: _wrong_crc,
    kinds.Silence: _nothing,
    kinds.Garbage: _garbage,
    **dict.fromkeys(REWRITING, _rewritten),
}
"""Of faults that carry nothing from shot to shot."""

"""Packets with the faults that a scenario orders: of what stamps them, of the packets and of the link."""

from __future__ import annotations

from typing import NamedTuple

from lidar_emu.device.state import Status
from lidar_emu.faults.build import numbered
from lidar_emu.faults.held_values import resumed
from lidar_emu.faults.packet_contents import ContentFaults, ContentState
from lidar_emu.faults.packets import PacketFaults, PacketState
from lidar_emu.faults.schedule import FaultOccurrence
from lidar_emu.measurement import Measurement
from lidar_emu.scenario.faults import ContentFault, DeviceFault, LinkFault, PacketFault
from lidar_emu.scenario.schema import Scenario
from lidar_emu.wire import Encoder, Packet

_OF_PACKETS = PacketFault | LinkFault | DeviceFault
"""Those of the port and of the device act elsewhere; here they are only told of."""


class WireState(NamedTuple):
    """What is carried from shot to shot."""

    stamps: ContentState
    packets: PacketState


class FaultyEncoder:
    """An encoder behind which things go wrong.

    Raises:
        InputError: a fault is none of this link.
    """

    def __init__(self, scenario: Scenario, encoder: Encoder, can: bool) -> None:
        seed, period_ns = scenario.seed, scenario.timing.period_ns
        self._encoder = encoder
        self._stamps = ContentFaults(numbered(scenario, ContentFault), seed, period_ns)
        self._packets = PacketFaults(
            numbered(scenario, _OF_PACKETS), seed, period_ns, encoder.interface, can, scenario.name
        )
        self.initial = WireState(self._stamps.initial, self._packets.initial)
        """What is carried before shot 0."""

    def packets(
        self, measurement: Measurement, stamped: Measurement, status: Status, state: WireState
    ) -> tuple[list[Packet], list[int], WireState, list[FaultOccurrence]]:
        """The packet of each of consecutive shots, perhaps empty; when each is due; what is carried on; and which
        faults acted.

        Args:
            measurement: of the shots.
            stamped: the same with the numbers and times that the device gives them.
            status: of the device through these shots.
            state: carried from the shots before.
        """
        wrong, stamps, by_stamp = stamped, state.stamps, list[FaultOccurrence]()
        if not status.silent:
            wrong, stamps, by_stamp = self._stamps.apply(measurement.shot, stamped, stamps)
        finished = list(self._encoder.packets(wrong, status))
        packets, due_ns, after, by_packet = self._packets.apply(
            measurement.shot, measurement.due_ns, finished, state.packets, status.silent
        )
        return packets, due_ns, WireState(stamps, after), by_stamp + by_packet

    def resumed(self, state: WireState | None) -> WireState:
        """What fewer of these faults have carried so far, for all of them."""
        if state is None:
            return self.initial
        held = resumed(state.packets.held, self.initial.packets.held)
        return WireState(resumed(state.stamps, self.initial.stamps), state.packets._replace(held=held))

    def longest(self, packet_bytes: int) -> int:
        """Of a packet, as the port takes it, that was so long before faults."""
        return self._packets.longest(packet_bytes)


def faulty_encoder(scenario: Scenario, encoder: Encoder, can: bool) -> FaultyEncoder | None:
    """None where the scenario orders no faults of packets.

    Raises:
        InputError: a fault is none of this link.
    """
    ordered = numbered(scenario, ContentFault) + numbered(scenario, _OF_PACKETS)
    return FaultyEncoder(scenario, encoder, can) if ordered else None

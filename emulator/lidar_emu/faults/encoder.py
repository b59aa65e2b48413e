"""Encode packets with the scenario's faults of packet contents, packets and link."""

from __future__ import annotations

from typing import NamedTuple

from lidar_emu.device.state import Status
from lidar_emu.faults.beams import extended
from lidar_emu.faults.build import indexed_faults
from lidar_emu.faults.packet_contents import ContentFaults, ContentState
from lidar_emu.faults.packets import FaultyPackets, PacketFaults, PacketState
from lidar_emu.faults.schedule import FaultOccurrence
from lidar_emu.measurement import Measurement
from lidar_emu.scenario.faults import ContentFault, DeviceFault, LinkFault, PacketFault
from lidar_emu.scenario.schema import Scenario
from lidar_emu.wire import Encoder

_REPORTED = PacketFault | LinkFault | DeviceFault
"""Faults of the port and of the device act elsewhere; only their occurrences are reported here."""


class WireState(NamedTuple):
    """State of the faults, passed from shot to shot."""

    contents: ContentState
    packets: PacketState


class FaultyEncoder:
    """An encoder with faults of packet contents and packets.

    Args:
        scenario: scenario with the faults.
        encoder: encoder without faults.
        can: whether the link is a CAN bus.

    Raises:
        InputError: a fault does not apply to this link.
    """

    def __init__(self, scenario: Scenario, encoder: Encoder, can: bool) -> None:
        seed, period_ns = scenario.seed, scenario.timing.period_ns
        self._encoder = encoder
        self._contents = ContentFaults(indexed_faults(scenario, ContentFault), seed, period_ns)
        self._packets = PacketFaults(
            indexed_faults(scenario, _REPORTED), seed, period_ns, encoder.interface, can, scenario.name
        )
        self.initial = WireState(self._contents.initial, self._packets.initial)
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
        sent, after_packets = self._packets.apply(
            measurement.shot, measurement.due_ns, finished, state.packets, status.silent
        )
        return sent._replace(faults=in_contents + sent.faults), WireState(after_contents, after_packets)

    def extended(self, state: WireState | None) -> WireState:
        """State of the first of these faults, extended by the initial state of the faults added behind them."""
        if state is None:
            return self.initial
        held = extended(state.packets.held, self.initial.packets.held)
        return WireState(extended(state.contents, self.initial.contents), state.packets._replace(held=held))

    def longest(self, packet_bytes: int) -> int:
        """Greatest length in bytes of a packet after faults, if it has `packet_bytes` before them."""
        return self._packets.longest(packet_bytes)


def faulty_encoder(scenario: Scenario, encoder: Encoder, can: bool) -> FaultyEncoder | None:
    """Encoder with the scenario's faults; None if none of them concerns packets, link or device.

    Raises:
        InputError: a fault does not apply to this link.
    """
    faults = indexed_faults(scenario, ContentFault) + indexed_faults(scenario, _REPORTED)
    return FaultyEncoder(scenario, encoder, can) if faults else None

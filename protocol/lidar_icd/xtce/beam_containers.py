"""Measurements of an XTCE database that every reader knows: a container for each number of beams."""

from __future__ import annotations

from lidar_icd.xtce.containers import ROOT, Containers


def add_measurement(containers: Containers) -> None:
    """Add packets with beams: the container for n beams extends the container for n - 1."""
    packet, name = containers.interface.packet, "measurement"
    length = packet.header.length
    criteria = containers.of_kind("measurement")
    if packet.beam is None:
        criteria.append(containers.of_length("==", length))
    entries = containers.add(name, ROOT, criteria, abstract=packet.beam is not None)
    containers.add_fields(entries, "header", packet.header)
    if packet.beam is None:
        containers.add_crc(entries)
        return
    for beam in range(packet.maximum_beams):
        length += packet.beam.length
        base, name = name, f"with_beam_{beam}"
        entries = containers.add(name, base, [containers.of_length(">=", length)], abstract=True)
        containers.add_fields(entries, "beam", packet.beam, suffix=f"_{beam}")
        exactly = [containers.of_length("==", length)]
        containers.add_crc(containers.add(f"measurement_{beam + 1}", name, exactly))

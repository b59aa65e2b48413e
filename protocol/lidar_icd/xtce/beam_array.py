"""Measurements of an XTCE database for readers that know arrays: one container, with an array of beams."""

from __future__ import annotations

from itertools import count

from lidar_icd.xtce.containers import ROOT, Containers, parts
from lidar_icd.xtce.types import add, add_text
from lidar_protocol.definition_fields import codec_of
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import Codec, Field, Number
from lidar_protocol.layout import Layout

_LENGTH = "beam_count"
"""Field of the header that states the length of the array."""

_BEAM, _BEAMS = "beam-aggregate", "beams-array"
"""Names of types."""


def has_beam_array(interface: Interface) -> bool:
    """Whether a packet has beams, and states their number."""
    return interface.packet.beam is not None and _LENGTH in interface.packet.header.names


def add_measurement(containers: Containers) -> None:
    """Add packets with beams: after the header, the array `beams` of aggregates."""
    packet = containers.interface.packet
    assert packet.beam is not None
    shortest = containers.of_length(">=", packet.header.length + packet.beam.length)
    longest = containers.of_length("<=", packet.longest)
    entries = containers.add("measurement", ROOT, [*containers.of_kind("measurement"), shortest, longest])
    containers.add_fields(entries, "header", packet.header)
    _add_aggregate(containers, packet.beam)
    _add_array(containers, codec_of(packet.header, _LENGTH))
    containers.add_array(entries, "beams", _BEAMS, "Beams of the shot")
    containers.add_crc(entries)


def _add_aggregate(containers: Containers, beam: Layout) -> None:
    """Add the type of a beam. Aggregates have no gaps: unused bits are members too, whose names must differ."""
    unused = count()
    members = [
        {
            "name": part.key,
            "typeRef": containers.type_of("beam", part),
            "shortDescription": part.meaning or None,
        }
        if isinstance(part, Field)
        else {"name": f"unused_{next(unused)}", "typeRef": containers.type_of_bits(part)}
        for part in parts(beam)
    ]
    aggregate = add(add(containers.types, "AggregateParameterType", name=_BEAM), "MemberList")
    for member in members:
        add(aggregate, "Member", **member)


def _add_array(containers: Containers, length: Codec | None) -> None:
    """Add the type of the array. Both its indices are inclusive; the last one is computed from a raw value."""
    offset = length.offset if isinstance(length, Number) else 0
    array = add(containers.types, "ArrayParameterType", name=_BEAMS, arrayTypeRef=_BEAM)
    dimension = add(add(array, "DimensionList"), "Dimension")
    add_text(add(dimension, "StartingIndex"), "FixedValue", "0")
    last = add(add(dimension, "EndingIndex"), "DynamicValue")
    add(last, "ParameterInstanceRef", parameterRef=_LENGTH, useCalibratedValue=False)
    add(last, "LinearAdjustment", slope=1, intercept=offset - 1)

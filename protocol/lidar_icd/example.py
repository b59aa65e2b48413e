"""Examples of the interface document: a shot with every kind of value, a command and an acknowledgement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from lidar_protocol.commands import Argument
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import Codec, Constant, Flag, Number, Real, Value
from lidar_protocol.layout import FILLED_IN, Layout

UNIT: Final = 0

HEADER: Final[Mapping[str, Value]] = {
    "time_ns": 1_500_490_773,
    "due_ns": 1_502_900_000,
    "mode": 4,
    "laser_on": True,
    "clock_locked": True,
    "shot": 30,
    "pattern": 0,
}

_MEASURED: Final[Mapping[str, Value]] = {
    "fired": True,
    "range_valid": True,
    "speed_valid": True,
    "sign_resolved": True,
    "segments": 7,
    "reason": 0,
    "returns": 1,
    "snr_db": 34.25,
    "range_m": 2164.784,
    "closing_speed_mps": 92.388,
    "second_range_m": None,
    "sigma_range_m": 0.1401,
    "sigma_speed_mps": 0.00102,
    "residual_mps": -0.0012,
    "beam_angle_deg": 22.5,
    "time_offset_s": 0.0,
    "second_sigma_range_m": None,
    "second_reason": 3,
}
_NO_MEASUREMENT: Final[Mapping[str, Value]] = {
    **dict.fromkeys(("range_valid", "speed_valid", "sign_resolved"), False),
    **dict.fromkeys(("segments", "returns"), 0),
    **dict.fromkeys(("snr_db", "range_m", "closing_speed_mps"), None),
    **dict.fromkeys(("sigma_range_m", "sigma_speed_mps", "residual_mps"), None),
}

BEAMS: Final[tuple[Mapping[str, Value], ...]] = (
    _MEASURED,
    {
        **_MEASURED,
        "closing_speed_mps": -46.194,
        "returns": 2,
        "second_range_m": 2171.5,
        "second_sigma_range_m": 0.205,
        "second_reason": 0,
        "time_offset_s": 0.0009,
    },
    {**_MEASURED, **_NO_MEASUREMENT, "segments": 5, "reason": 3, "snr_db": 11.5, "time_offset_s": 0.0018},
    {
        **_MEASURED,
        **_NO_MEASUREMENT,
        "fired": False,
        "reason": 1,
        "second_reason": 1,
        "beam_angle_deg": None,
        "time_offset_s": None,
    },
)
"""A measurement; a receding surface with a second return; an echo below the threshold; a beam that did not fire."""


def shot(interface: Interface) -> tuple[Mapping[str, Value], Sequence[Mapping[str, Value]]]:
    """Example shot in the fields of any interface; fields without an example value get an arbitrary valid one."""
    packet = interface.packet
    layouts = [packet.header, *([packet.beam] if packet.beam else [])]
    layouts += [message.layout for message in interface.can.messages] if interface.can else []
    made_up = {name: value for layout in layouts for name, value in values(layout).items()}
    count = max(len(BEAMS), packet.beams_in_header)
    count = min(count, packet.maximum_beams, interface.can.beam_slots if interface.can else count)
    beams = [made_up | dict(BEAMS[k % len(BEAMS)]) for k in range(max(count, packet.beams_in_header))]
    # The mode of the example, with its number in the interface.
    mode = next((p.field.enumeration for p in packet.header.placed if p.field.name == "mode"), None)
    track = interface.enumerations.get(mode or "", {}).get("track", HEADER["mode"])
    timed = {"mode": track, "time_s": 1.500490773, "due_s": 1.5029}
    return made_up | dict(HEADER) | timed, beams


def values(layout: Layout) -> dict[str, Value]:
    """Arbitrary valid values for the fields that the library does not fill in."""
    return {
        placed.field.name: _arbitrary(placed.field.codec)
        for placed in layout.placed
        if placed.field.name not in FILLED_IN
    }


def _arbitrary(codec: Codec) -> Value:
    if isinstance(codec, Flag):
        return True
    if isinstance(codec, Number | Real):
        return max(codec.limits[0], min(1, codec.limits[1]))
    return 0 if isinstance(codec, Constant) else 1


def command(interface: Interface) -> tuple[str, dict[str, Argument]]:
    """Example command: its name, and its sequence number and arguments. A command with arguments is preferred."""
    assert interface.commands is not None
    chosen = max(
        interface.commands.commands, key=lambda each: (each.name == "set_rate_hz", len(each.arguments))
    )
    fields = {placed.field.name: placed.field for placed in chosen.packet.placed}
    given: dict[str, Argument] = {"sequence": 7}
    for name in chosen.arguments:
        words = interface.enumerations.get(fields[name].enumeration or "", {})
        given[name] = next(iter(words), None) or _arbitrary(fields[name].codec)
    return chosen.name, given


def acknowledgement(interface: Interface) -> dict[str, Argument]:
    """Example acknowledgement, with the verdict `accepted`."""
    assert interface.acknowledge is not None
    return {**values(interface.acknowledge), "sequence": 7, "verdict": "accepted"}

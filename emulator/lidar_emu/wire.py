"""From a measurement to what the wire carries, and from what arrived back to a table's rows.

The only file that knows both `Measurement` and `lidar_protocol`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.scenario.schema import Wire
from lidar_protocol import CanFrame, CanSet, Device, EncodeError, Message, default_interface
from lidar_protocol.fields import Value

Packet = bytes | list[CanFrame]
"""What one shot is on a link: framed bytes, or CAN frames in the order of sending."""

_SAME_ON_THE_WIRE = (
    "fired",
    "range_valid",
    "speed_valid",
    "sign_resolved",
    "segments",
    "reason",
    "returns",
    "snr_db",
    "range_m",
    "closing_speed_mps",
    "second_range_m",
    "sigma_range_m",
    "sigma_speed_mps",
    "residual_mps",
    "beam_angle_deg",
)


class Encoder:
    """Packets of one unit for one kind of link.

    Args:
        wire: the unit, and on classic CAN the set of messages.
        can: whether the link is a CAN bus.
        fd: whether it carries CAN FD frames.
        beam_count: beams of a shot.

    Raises:
        InputError: the interface has no place for so many beams.
    """

    def __init__(self, wire: Wire, can: bool, fd: bool, beam_count: int) -> None:
        interface = default_interface()
        self._device = Device(interface, wire.unit)
        self._can_set: CanSet | None = ("fd" if fd else wire.can_messages) if can else None
        limit = interface.can.beam_slots if can else interface.packet.maximum_beams
        if beam_count > limit:
            place = "a CAN bus" if can else "a packet"
            raise InputError("scenario", "beams", beam_count, f"allowed: at most {limit} on {place}")
        self._track = interface.enumerations["mode"]["track"]

    def packets(self, measurement: Measurement) -> Iterator[Packet]:
        """The packet of each shot; a function of the measurement alone."""
        for header, beams in self._shots(measurement):
            try:
                if self._can_set is None:
                    yield self._device.serial_bytes(header, beams)
                else:
                    yield self._device.can_frames(self._can_set, header, beams)
            except EncodeError as error:
                raise InputError("wire", f"shot {header['shot']}", "a measurement", str(error)) from None

    def _shots(
        self, measurement: Measurement
    ) -> Iterator[tuple[Mapping[str, Value], Sequence[Mapping[str, Value]]]]:
        # Lists of Python numbers: the protocol knows no arrays, and float(array element) costs more.
        columns = [getattr(measurement, name).tolist() for name in _SAME_ON_THE_WIRE]
        first_ns = measurement.time_ns.min(axis=1)
        offsets_s = ((measurement.time_ns - first_ns[:, None]) * 1e-9).tolist()
        times = zip(
            measurement.shot.tolist(), first_ns.tolist(), measurement.due_ns.tolist(), offsets_s, strict=True
        )
        for row, (shot, time_ns, due_ns, offset_s) in enumerate(times):
            header = {
                "time_ns": time_ns,
                "due_ns": due_ns,
                "mode": self._track,
                "laser_on": True,
                "clock_locked": True,
                "shot": shot,
            }
            beams = [
                dict(zip(_SAME_ON_THE_WIRE, values, strict=True), time_offset_s=beam_offset_s)
                for *values, beam_offset_s in zip(*(column[row] for column in columns), offset_s, strict=True)
            ]
            yield header, beams


def rows(message: Message) -> list[dict[str, Any]]:
    """What arrived, one row per beam, under the names of `Measurement.table`; None where a value is missing.

    `packet_time_s` is the time of validity of the beams that fired first. Core CAN messages carry a part of the
    columns only: without a time offset a beam's own time is unknown.
    """
    packet_time_s = None if message.time_ns is None else message.time_ns * 1e-9
    unit = {"unit": message.unit, "shot": message.shot, "packet_time_s": packet_time_s}
    result = []
    for beam, values in enumerate(message.beams):
        row: dict[str, Any] = {**unit, "beam": beam, "time_s": _time_s(message, values)}
        row.update((name, values[name]) for name in _SAME_ON_THE_WIRE if name in values)
        result.append(row)
    return result


def _time_s(message: Message, beam: Mapping[str, Value]) -> float | None:
    offset_s = beam.get("time_offset_s")
    if message.time_ns is None or offset_s is None or not beam.get("fired"):
        return None
    return message.time_ns * 1e-9 + offset_s

"""slcan by hand: lines of text to CAN frames, and those through cantools with the DBC alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools
from comparison import SERIAL_HELD, SERIAL_STEPS

import lidar_protocol

DATABASE: Any = cantools.database.load_file(Path(lidar_protocol.__file__).parent / "lidar.dbc")
FD_LENGTHS = dict(zip("0123456789ABCDEF", (*range(9), 12, 16, 20, 24, 32, 48, 64), strict=True))
CORE_STEPS = {"snr_db": 1.0, "range_m": 0.001, "closing_speed_mps": 0.0001}
CORE_HELD = {"snr_db": (0.0, 62.0)}
CORE_EXACT = ("range_valid", "speed_valid", "sign_resolved", "segments")
FULL_STEPS = SERIAL_STEPS | CORE_STEPS | {"second_range_m": 0.01, "second_sigma_range_m": 0.005}
FULL_HELD = SERIAL_HELD | CORE_HELD | {"second_sigma_range_m": (0.0, 1.27)}
FULL_EXACT = (*CORE_EXACT, "reason", "returns", "second_reason")
BEAM_SLOTS = 8
BEAM_MESSAGES = {"Beam", "Quality", "Geometry", "FdBeam"}
SHOT_MESSAGES = BEAM_MESSAGES | {"Header", "Status", "Shot", "FdHeader"}


@dataclass(frozen=True)
class Line:
    """A frame with an 11-bit identifier."""

    kind: str
    """`t` classic, `d` FD, `b` FD with bit rate switch."""
    can_id: int
    data: bytes


def frames(stream: bytes | bytearray) -> list[Line]:
    """The data frames of a stream of slcan lines, configuration passed over."""
    *lines, rest = bytes(stream).decode("ascii").split("\r")
    assert rest == "", "the stream ends inside a line"
    return [_frame(line) for line in lines if line[:1] in set("tTdDbBrR")]


def _frame(line: str) -> Line:
    assert line[0] in "tdb", f"{line} is no data frame with a standard identifier"
    data = bytes.fromhex(line[5:])
    assert len(data) == FD_LENGTHS[line[4]]
    return Line(line[0], int(line[1:4], 16), data)


def of_shots(lines: Iterable[Line], unit: int = 0) -> list[Line]:
    """The frames of shots: housekeeping and acknowledgements have other identifiers."""
    return [line for line in lines if _message(line, unit).name.rstrip("0123456789") in SHOT_MESSAGES]


def _message(line: Line, unit: int) -> Any:
    return DATABASE.get_message_by_frame_id(line.can_id - 0x40 * unit)


def shots(lines: Iterable[Line], unit: int = 0) -> list[dict[str, Any]]:
    """Shots as the DBC reads them: values of the header messages, and `beams`, one mapping per slot.

    A new shot begins with each (FD) header; every frame of a shot carries the same counter.
    """
    result: list[dict[str, Any]] = []
    for number, line in enumerate(of_shots(lines, unit)):
        message = _message(line, unit)
        values = {name: _plain(value) for name, value in message.decode(line.data).items()}
        counter = values.pop("shot_counter")
        name, slot = message.name.rstrip("0123456789"), (line.can_id % BEAM_SLOTS)
        if name in ("Header", "FdHeader"):
            result.append(
                {"counter": counter, "beams": [{} for _ in range(values["beam_count"])], "messages": []}
            )
        shot = result[-1]
        if shot["counter"] != counter:
            raise AssertionError(f"frame {number}, {line}, is of another shot than {shot}")
        shot["messages"].append(message.name)
        (shot["beams"][slot] if name in BEAM_MESSAGES else shot).update(values)
    return result


def rows(decoded: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per beam. The core set has no shot number: shots are then counted by their counters."""
    result, shot = [], -1
    for each in decoded:
        shot = each.get("shot", shot + 1 + (each["counter"] - shot - 1) % 16)
        result += [{"shot": shot, "beam": beam, **values} for beam, values in enumerate(each["beams"])]
    return result


def _plain(value: Any) -> Any:
    """A number, or None for the codes that stand for no value."""
    if isinstance(value, cantools.database.namedsignalvalue.NamedSignalValue):
        # "none" is also the name of segments 0.
        return None if value.name in ("none", "absent") and value.value != 0 else value.value
    return value

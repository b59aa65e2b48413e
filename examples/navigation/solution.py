"""The navigation message: what the navigator reports to the lidar's bench, by the fields of the interface."""

from collections.abc import Iterator, Mapping

import numpy as np
from beams import Array, Shot
from error_state import HEIGHT, POSITION, VELOCITY
from navigation import Navigator, UpdateResult

from lidar_protocol import default_interface
from lidar_protocol.commands import Argument
from lidar_protocol.fields import Number

NAME = "navigation"
Solution = Mapping[str, Argument]

_COMMANDS = default_interface().commands
assert _COMMANDS is not None
_MESSAGE = _COMMANDS.messages_by_name[NAME]
_CODECS = {placed.field.key: placed.field.codec for placed in _MESSAGE.packet.placed}


def solution(navigator: Navigator, shot: Shot, result: tuple[UpdateResult, UpdateResult]) -> Solution:
    """Values of the message after a shot. Height is above the ground, so that there is no position upwards."""
    state, (ranges, speeds) = navigator.state, result
    sigma = np.sqrt(np.diag(state.covariance))
    values: dict[str, Argument] = dict.fromkeys(_MESSAGE.arguments)
    values |= {name: "not_judged" for name in values if "_trust_" in name}
    values |= {"time_ns": shot.time_ns, "mode": _mode(ranges, speeds)}
    numbers = {"altitude_m": state.height_m, "sigma_altitude_m": sigma[HEIGHT]}
    for k, axis in enumerate(("east", "north", "up")):
        if k != HEIGHT:
            numbers[f"position_{axis}_m"] = state.position_site_m[k]
            numbers[f"sigma_position_{axis}_m"] = sigma[POSITION][k]
        numbers[f"velocity_{axis}_mps"] = state.velocity_site_mps[k]
        numbers[f"sigma_velocity_{axis}_mps"] = sigma[VELOCITY][k]
    values |= {name: _sendable(name, float(number)) for name, number in numbers.items()}
    for what, measured, update in (
        ("range", shot.range_m, ranges),
        ("speed", shot.closing_speed_mps, speeds),
    ):
        trusts = ((f"{what}_trust_{beam}", word) for beam, word in enumerate(_trusts(measured, update)))
        values |= {name: word for name, word in trusts if name in values}
    return values


def _sendable(name: str, number: float) -> float | None:
    """A number, None if the field cannot hold it: a diverged estimate goes beyond any limit."""
    codec = _CODECS[name]
    assert isinstance(codec, Number)
    return number if codec.limits[0] <= number <= codec.limits[1] else None


def _mode(ranges: UpdateResult, speeds: UpdateResult) -> str:
    if ranges.reinitialised or speeds.reinitialised:
        return "reinitialised"
    return "aided" if ranges.accepted or speeds.accepted else "inertial"


def _trusts(measured: Array, update: UpdateResult) -> Iterator[str]:
    """What became of each beam's value. Nothing is judged while the noise is being learned."""
    judged = iter(update.used)
    for value in measured:
        if np.isnan(value):
            yield "invalid"
        else:
            yield {True: "used", False: "gated", None: "not_judged"}[next(judged, None)]

"""Variables of the FMU, each numbered by its place; the number is its value reference for every type."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Literal

FACING_DOWN = (0.0, sqrt(0.5), sqrt(0.5), 0.0)
"""Start of `site_from_body`: body x north, z down."""


@dataclass(frozen=True)
class Variable:
    """A scalar variable.

    Args:
        name: name in the FMU.
        kind: type of its value.
        causality: parameter, input or output.
        start: value before the simulation.
        unit: unit of a Real; None: without dimension.
        description: meaning, for people.
    """

    name: str
    kind: Literal["Real", "Integer", "Boolean"]
    causality: Literal["parameter", "input", "output"]
    start: float
    unit: str | None
    description: str


def given_variables() -> list[Variable]:
    """Variables that the simulator sets: the vehicle's state, and whether its acceleration is known."""
    site, body = ("east", "north", "up"), ("x", "y", "z")
    return [
        Variable(
            "acceleration_known",
            "Boolean",
            "parameter",
            0.0,
            None,
            "The input acceleration_site_mps2 is used",
        ),
        *_vector("position_site_m", "m", "Position of the reference point", site, (0.0, 0.0, 1000.0)),
        *_vector("velocity_site_mps", "m/s", "Velocity in the site frame", site),
        *_vector("acceleration_site_mps2", "m/s2", "Second derivative of the position", site),
        *_vector(
            "site_from_body", None, "Unit quaternion, body to site frame", ("w", "x", "y", "z"), FACING_DOWN
        ),
        *_vector("body_rate_radps", "rad/s", "Angular rate against the site", body),
    ]


def measured_variables(beam_count: int) -> list[Variable]:
    """Variables that the lidar sets: counters, and the newest packet."""
    beams = [
        variable
        for beam in range(1, beam_count + 1)
        for variable in (
            Variable(f"range_m[{beam}]", "Real", "output", 0.0, "m", "Range, 0 without a valid one"),
            Variable(
                f"closing_speed_mps[{beam}]",
                "Real",
                "output",
                0.0,
                "m/s",
                "Closing speed, 0 without a valid one",
            ),
            Variable(f"range_valid[{beam}]", "Boolean", "output", 0.0, None, "The range is valid"),
            Variable(f"speed_valid[{beam}]", "Boolean", "output", 0.0, None, "The closing speed is valid"),
        )
    ]
    return [
        Variable("packets", "Integer", "output", 0.0, None, "Packets with measurements received so far"),
        Variable("rejected", "Integer", "output", 0.0, None, "Shot packets that could not be decoded so far"),
        Variable("shot", "Integer", "output", -1.0, None, "Shot number in the newest packet; -1 before it"),
        Variable(
            "time_s", "Real", "output", 0.0, "s", "Time of validity in the newest packet, from the epoch"
        ),
        Variable("sent_s", "Real", "output", 0.0, "s", "Scenario time at which the newest packet was sent"),
        *beams,
    ]


def _vector(
    name: str, unit: str | None, text: str, axes: tuple[str, ...], start: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> list[Variable]:
    return [
        Variable(f"{name}[{number}]", "Real", "input", value, unit, f"{text}: {axis}")
        for number, (axis, value) in enumerate(zip(axes, start, strict=True), 1)
    ]

"""A unit of co-simulation, and what a version of FMI makes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lidar_emu.fmu.variables import Variable

IDENTIFIER = "lidar_emu"


@dataclass(frozen=True)
class Unit:
    """A unit of co-simulation.

    Args:
        name: name of the scenario; any text.
        token: identity, also compiled into the library.
        step_s: communication step to use by default.
        given: variables that the simulator sets.
        measured: variables that the lidar sets.
    """

    name: str
    token: str
    step_s: float
    given: tuple[Variable, ...]
    measured: tuple[Variable, ...]


@dataclass(frozen=True)
class Standard:
    """A version of FMI.

    Args:
        sources: files in C to compile.
        headers: files that they include, besides `config.h`.
        platform: folder of the library.
        variables: variables of a unit in the order of their places: given, measured, others.
        descriptions: files of XML for a unit, by their paths in the FMU.
    """

    sources: tuple[str, ...]
    headers: tuple[str, ...]
    platform: str
    variables: Callable[[Unit], list[Variable]]
    descriptions: Callable[[Unit], dict[str, bytes]]

"""The variables of an FMU, and its files by FMI 2.0 (a variable for each element of an array, no bytes) and FMI 3.0."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from math import sqrt
from typing import Literal
from xml.etree import ElementTree as Xml

from lidar_emu._version import __version__

FACING_DOWN = (0.0, sqrt(0.5), sqrt(0.5), 0.0)
"""Start of `site_from_body`: body x north, z down."""


@dataclass(frozen=True)
class Variable:
    """A variable, or an array.

    Args:
        name: name in the FMU.
        kind: type of its values.
        causality: parameter, input, output, or the independent variable.
        description: meaning, for people.
        start: value before the simulation; a tuple: the values of an array.
        unit: unit of a real; None: without dimension.
        axes: names of an array's elements, where they have one.
    """

    name: str
    kind: Literal["real", "integer", "boolean", "bytes"]
    causality: Literal["parameter", "input", "output", "independent"]
    description: str
    start: float | tuple[float, ...] = 0.0
    unit: str | None = None
    axes: tuple[str, ...] = ()

    @property
    def starts(self) -> tuple[float, ...]:
        """Start values, also of a scalar."""
        return self.start if isinstance(self.start, tuple) else (self.start,)

    @property
    def variability(self) -> Literal["fixed", "discrete", "continuous"]:
        """How values change over time."""
        if self.causality == "parameter":
            return "fixed"
        return "discrete" if self.causality == "output" else "continuous"

    def scalars(self) -> list[Variable]:
        """Each element of an array as a variable, numbered from 1; a scalar is returned as it is."""
        if not isinstance(self.start, tuple):
            return [self]
        texts = [f"{self.description}: {axis}" for axis in self.axes] or [self.description] * len(self.start)
        return [
            replace(self, name=f"{self.name}[{number}]", start=value, description=text, axes=())
            for number, (value, text) in enumerate(zip(self.start, texts, strict=True), 1)
        ]


def given_variables() -> list[Variable]:
    """Variables that the simulator sets: the vehicle's state, and whether its acceleration is known."""
    site, body = ("east", "north", "up"), ("x", "y", "z")
    at_rest = (0.0, 0.0, 0.0)

    def vector(
        name: str, unit: str | None, text: str, axes: tuple[str, ...], start: tuple[float, ...]
    ) -> Variable:
        return Variable(name, "real", "input", text, start, unit, axes)

    return [
        Variable("acceleration_known", "boolean", "parameter", "The input acceleration_site_mps2 is used"),
        vector("position_site_m", "m", "Position of the reference point", site, (0.0, 0.0, 1000.0)),
        vector("velocity_site_mps", "m/s", "Velocity in the site frame", site, at_rest),
        vector("acceleration_site_mps2", "m/s2", "Second derivative of the position", site, at_rest),
        vector(
            "site_from_body", None, "Unit quaternion, body to site frame", ("w", "x", "y", "z"), FACING_DOWN
        ),
        vector("body_rate_radps", "rad/s", "Angular rate against the site", body, at_rest),
    ]


def measured_variables(beam_count: int) -> list[Variable]:
    """Variables that the lidar sets: counters, and the newest packet with an element per beam."""
    none = (0.0,) * beam_count
    return [
        Variable("packets", "integer", "output", "Packets with measurements received so far"),
        Variable("rejected", "integer", "output", "Shot packets that could not be decoded so far"),
        Variable("shot", "integer", "output", "Shot number in the newest packet; -1 before it", -1.0),
        Variable(
            "time_s", "real", "output", "Time of validity in the newest packet, from the epoch", unit="s"
        ),
        Variable("sent_s", "real", "output", "Scenario time at which the newest packet was sent", unit="s"),
        Variable("range_m", "real", "output", "Range, 0 without a valid one", none, "m"),
        Variable("closing_speed_mps", "real", "output", "Closing speed, 0 without a valid one", none, "m/s"),
        Variable("range_valid", "boolean", "output", "The range is valid", none),
        Variable("speed_valid", "boolean", "output", "The closing speed is valid", none),
    ]


SIMULATION_TIME = Variable("time", "real", "independent", "Scenario time", unit="s")
SENT_BYTES = Variable(
    "serial_bytes",
    "bytes",
    "output",
    "What the device sent in the newest step, as on a serial line: packets in their order, or nothing",
)


def start_values(variables: Iterable[Variable]) -> list[float]:
    """Start values at all places."""
    return [value for variable in variables for value in variable.starts]


def numbered(variables: Sequence[Variable]) -> list[tuple[int, Variable]]:
    """Variables with their value references."""
    ends = accumulate(len(variable.starts) for variable in variables)
    return [(end - len(variable.starts), variable) for end, variable in zip(ends, variables, strict=True)]


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


_UNITS = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad/s": {"rad": 1, "s": -1},
    "s": {"s": 1},
}


def description_of(
    unit: Unit, version: str, attributes: Mapping[str, str]
) -> tuple[Xml.Element, Xml.Element]:
    """The root of a model description as far as its variables, and its element CoSimulation.

    Args:
        unit: the unit.
        version: version of FMI.
        attributes: attributes of the root that the version has alone.
    """
    root = Xml.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": _printable(unit.name),
            "description": "Emulated multi-beam Doppler lidar: the vehicle's state in, measurements out",
            "version": __version__,
            "generationTool": f"lidar-emu {__version__}",
            "variableNamingConvention": "structured",
            **attributes,
        },
    )
    simulation = Xml.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=IDENTIFIER,
        needsExecutionTool="true",
        canHandleVariableCommunicationStepSize="true",
    )
    units = Xml.SubElement(root, "UnitDefinitions")
    for symbol, exponents in _UNITS.items():
        base = {key: str(exponent) for key, exponent in exponents.items()}
        Xml.SubElement(Xml.SubElement(units, "Unit", name=symbol), "BaseUnit", base)
    Xml.SubElement(Xml.SubElement(root, "LogCategories"), "Category", name="logStatusError")
    Xml.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(unit.step_s))
    return root, simulation


def start_text(variable: Variable) -> str:
    """Start values as a list in XML."""
    write = {
        "real": repr,
        "integer": lambda value: str(int(value)),
        "boolean": lambda value: str(bool(value)).lower(),
    }[variable.kind]
    return " ".join(map(write, variable.starts))


def xml_bytes(root: Xml.Element) -> bytes:
    """An XML file."""
    Xml.indent(root)
    return bytes(Xml.tostring(root, encoding="UTF-8", xml_declaration=True))


def _printable(text: str) -> str:
    """The text without characters that XML does not allow."""
    return "".join(character if character.isprintable() else "?" for character in text)


_FMI2_SOURCES = ("lidar.c", "lidar_fmi2.c")


def _scalar_variables(unit: Unit) -> list[Variable]:
    return [scalar for variable in (*unit.given, *unit.measured) for scalar in variable.scalars()]


def _fmi2_description(unit: Unit) -> dict[str, bytes]:
    root, simulation = description_of(unit, "2.0", {"guid": unit.token, "numberOfEventIndicators": "0"})
    files = Xml.SubElement(simulation, "SourceFiles")
    for source in _FMI2_SOURCES:
        Xml.SubElement(files, "File", name=source)
    listed = Xml.SubElement(root, "ModelVariables")
    outputs = Xml.SubElement(Xml.SubElement(root, "ModelStructure"), "Outputs")
    for number, variable in numbered(_scalar_variables(unit)):
        _add_scalar(listed, number, variable)
        if variable.causality == "output":
            Xml.SubElement(outputs, "Unknown", index=str(number + 1), dependencies="")
    return {"modelDescription.xml": xml_bytes(root)}


def _add_variable(
    listed: Xml.Element, tag: str, number: int, variable: Variable, description: str
) -> Xml.Element:
    added = Xml.SubElement(
        listed,
        tag,
        name=variable.name,
        valueReference=str(number),
        description=description,
        causality=variable.causality,
        variability=variable.variability,
    )
    if variable.causality == "output":
        added.set("initial", "exact")
    return added


def _add_scalar(listed: Xml.Element, number: int, variable: Variable) -> None:
    scalar = _add_variable(listed, "ScalarVariable", number, variable, variable.description)
    value = Xml.SubElement(scalar, variable.kind.capitalize(), start=start_text(variable))
    if variable.unit is not None:
        value.set("unit", variable.unit)


FMI2 = Standard(
    _FMI2_SOURCES,
    ("lidar.h", "fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "linux64",
    _scalar_variables,
    _fmi2_description,
)


_FMI3_SOURCES = ("lidar.c", "lidar_fmi3.c")
_TYPES = {"real": "Float64", "integer": "Int64", "boolean": "Boolean", "bytes": "Binary"}


def _array_variables(unit: Unit) -> list[Variable]:
    return [*unit.given, *unit.measured, SIMULATION_TIME, SENT_BYTES]  # lidar_fmi3.c has the time's place


def _fmi3_description(unit: Unit) -> dict[str, bytes]:
    root, _ = description_of(unit, "3.0", {"instantiationToken": unit.token})
    listed = Xml.SubElement(root, "ModelVariables")
    structure = Xml.SubElement(root, "ModelStructure")
    for number, variable in numbered(_array_variables(unit)):
        _add_array(listed, number, variable)
        if variable.causality == "output":
            Xml.SubElement(structure, "Output", valueReference=str(number), dependencies="")
    return {"modelDescription.xml": xml_bytes(root), "sources/buildDescription.xml": _build_description()}


def _add_array(listed: Xml.Element, number: int, variable: Variable) -> None:
    axes = f": {', '.join(variable.axes)}" if variable.axes else ""
    value = _add_variable(listed, _TYPES[variable.kind], number, variable, variable.description + axes)
    if variable.unit is not None:
        value.set("unit", variable.unit)
    if isinstance(variable.start, tuple):
        Xml.SubElement(value, "Dimension", start=str(len(variable.start)))
    if variable.kind == "bytes":
        Xml.SubElement(value, "Start", value="")
    elif variable.causality != "independent":
        value.set("start", start_text(variable))


def _build_description() -> bytes:
    root = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    build = Xml.SubElement(root, "BuildConfiguration", modelIdentifier=IDENTIFIER)
    files = Xml.SubElement(build, "SourceFileSet", language="C11")
    for source in _FMI3_SOURCES:
        Xml.SubElement(files, "SourceFile", name=source)
    return xml_bytes(root)


FMI3 = Standard(
    _FMI3_SOURCES,
    ("lidar.h", "fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
    f"{platform.machine()}-linux",
    _array_variables,
    _fmi3_description,
)

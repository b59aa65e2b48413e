"""An FMU's files by FMI 2.0, where each element of an array is a variable and there are no bytes, and by FMI 3.0."""

from __future__ import annotations

import platform
from xml.etree import ElementTree as Xml

from lidar_emu.fmu.model_description import (
    IDENTIFIER,
    SENT_BYTES,
    SIMULATION_TIME,
    Standard,
    Unit,
    Variable,
    description_of,
    numbered,
    start_text,
    xml_bytes,
)

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


def _add_scalar(listed: Xml.Element, number: int, variable: Variable) -> None:
    scalar = Xml.SubElement(
        listed,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(number),
        description=variable.description,
        causality=variable.causality,
        variability=variable.variability,
    )
    if variable.causality == "output":
        scalar.set("initial", "exact")
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
    value = Xml.SubElement(
        listed,
        _TYPES[variable.kind],
        name=variable.name,
        valueReference=str(number),
        description=variable.description + axes,
        causality=variable.causality,
        variability=variable.variability,
    )
    if variable.causality == "output":
        value.set("initial", "exact")
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

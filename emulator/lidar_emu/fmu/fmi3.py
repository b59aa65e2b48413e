"""An FMU's files by FMI 3.0: arrays are variables, and so are the bytes that the device sends."""

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

_SOURCES = ("lidar.c", "lidar_fmi3.c")
_TYPES = {"real": "Float64", "integer": "Int64", "boolean": "Boolean", "bytes": "Binary"}


def _variables(unit: Unit) -> list[Variable]:
    return [*unit.given, *unit.measured, SIMULATION_TIME, SENT_BYTES]  # lidar_fmi3.c has the time's place


def _descriptions(unit: Unit) -> dict[str, bytes]:
    root, _ = description_of(unit, "3.0", {"instantiationToken": unit.token})
    listed = Xml.SubElement(root, "ModelVariables")
    structure = Xml.SubElement(root, "ModelStructure")
    for number, variable in numbered(_variables(unit)):
        _add(listed, number, variable)
        if variable.causality == "output":
            Xml.SubElement(structure, "Output", valueReference=str(number), dependencies="")
    return {"modelDescription.xml": xml_bytes(root), "sources/buildDescription.xml": _build_description()}


def _add(listed: Xml.Element, number: int, variable: Variable) -> None:
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
    for source in _SOURCES:
        Xml.SubElement(files, "SourceFile", name=source)
    return xml_bytes(root)


FMI3 = Standard(
    _SOURCES,
    ("lidar.h", "fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
    f"{platform.machine()}-linux",
    _variables,
    _descriptions,
)

"""An FMU's files by FMI 2.0: each element of an array is a variable, and there are no bytes."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

from lidar_emu.fmu.model_description import (
    Standard,
    Unit,
    Variable,
    description_of,
    numbered,
    start_text,
    xml_bytes,
)

_SOURCES = ("lidar.c", "lidar_fmi2.c")


def _variables(unit: Unit) -> list[Variable]:
    return [scalar for variable in (*unit.given, *unit.measured) for scalar in variable.scalars()]


def _descriptions(unit: Unit) -> dict[str, bytes]:
    root, simulation = description_of(unit, "2.0", {"guid": unit.token, "numberOfEventIndicators": "0"})
    files = Xml.SubElement(simulation, "SourceFiles")
    for source in _SOURCES:
        Xml.SubElement(files, "File", name=source)
    listed = Xml.SubElement(root, "ModelVariables")
    outputs = Xml.SubElement(Xml.SubElement(root, "ModelStructure"), "Outputs")
    for number, variable in numbered(_variables(unit)):
        _add(listed, number, variable)
        if variable.causality == "output":
            Xml.SubElement(outputs, "Unknown", index=str(number + 1), dependencies="")
    return {"modelDescription.xml": xml_bytes(root)}


def _add(listed: Xml.Element, number: int, variable: Variable) -> None:
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
    _SOURCES,
    ("lidar.h", "fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "linux64",
    _variables,
    _descriptions,
)

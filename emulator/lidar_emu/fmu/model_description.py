"""`modelDescription.xml` of the FMU."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as Xml

from lidar_emu import __version__
from lidar_emu.fmu.variables import Variable

IDENTIFIER = "lidar_emu"
SOURCES = ("lidar_fmu.c",)
_UNITS = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad/s": {"rad": 1, "s": -1},
    "s": {"s": 1},
}


def model_description(name: str, guid: str, variables: Sequence[Variable], step_s: float) -> bytes:
    """The description of a co-simulation unit, FMI 2.0.

    Args:
        name: name of the scenario; any text.
        guid: identity of the unit, also compiled into its library.
        variables: all variables, in the order of their value references.
        step_s: communication step to use by default.
    """
    root = Xml.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=_printable(name),
        guid=guid,
        description="Emulated multi-beam Doppler lidar: the vehicle's state in, measurements out",
        version=__version__,
        generationTool=f"lidar-emu {__version__}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    unit = Xml.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=IDENTIFIER,
        needsExecutionTool="true",
        canHandleVariableCommunicationStepSize="true",
    )
    files = Xml.SubElement(unit, "SourceFiles")
    for source in SOURCES:
        Xml.SubElement(files, "File", name=source)
    units = Xml.SubElement(root, "UnitDefinitions")
    for symbol, exponents in _UNITS.items():
        base = {key: str(exponent) for key, exponent in exponents.items()}
        Xml.SubElement(Xml.SubElement(units, "Unit", name=symbol), "BaseUnit", base)
    Xml.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(step_s))
    listed = Xml.SubElement(root, "ModelVariables")
    for number, variable in enumerate(variables):
        _add(listed, number, variable)
    outputs = Xml.SubElement(Xml.SubElement(root, "ModelStructure"), "Outputs")
    for number, variable in enumerate(variables, 1):
        if variable.causality == "output":
            Xml.SubElement(outputs, "Unknown", index=str(number), dependencies="")
    Xml.indent(root)
    return bytes(Xml.tostring(root, encoding="UTF-8", xml_declaration=True))


def _add(listed: Xml.Element, number: int, variable: Variable) -> None:
    kind, causality = variable.kind, variable.causality
    scalar = Xml.SubElement(
        listed,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(number),
        description=variable.description,
        causality=causality,
        variability="fixed"
        if causality == "parameter"
        else "continuous"
        if kind == "Real" and causality == "input"
        else "discrete",
    )
    if causality == "output":
        scalar.set("initial", "exact")
    start = {
        "Real": repr(variable.start),
        "Integer": str(int(variable.start)),
        "Boolean": str(bool(variable.start)).lower(),
    }[kind]
    value = Xml.SubElement(scalar, kind, start=start)
    if variable.unit is not None:
        value.set("unit", variable.unit)


def _printable(text: str) -> str:
    """The text without characters that XML does not allow."""
    return "".join(character if character.isprintable() else "?" for character in text)

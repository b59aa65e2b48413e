"""What the model descriptions of all versions of FMI have in common."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree as Xml

from lidar_emu._version import __version__
from lidar_emu.fmu.standard import IDENTIFIER, Unit
from lidar_emu.fmu.variables import Variable

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

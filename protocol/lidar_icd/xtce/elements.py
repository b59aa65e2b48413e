"""XML elements of XTCE, with names and texts that the schema accepts."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

Element = ElementTree.Element

NAMESPACE = "http://www.omg.org/spec/XTCE/20180204"

_UNFIT = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that no XML document may hold, not even escaped."""


def add(parent: Element, tag: str, **attributes: object) -> Element:
    """Add an element; attributes of None are left out."""
    given = {name: _text(value) for name, value in attributes.items() if value is not None}
    return ElementTree.SubElement(parent, tag, given)


def add_text(parent: Element, tag: str, text: str) -> None:
    """Add an element that holds a text."""
    add(parent, tag).text = _text(text)


def compare(parent: Element, parameter: str, operator: str, value: float) -> Element:
    """Add a comparison of a parameter's raw value with a number."""
    comparison = {"parameterRef": parameter, "comparisonOperator": operator, "value": value}
    return add(parent, "Comparison", **comparison, useCalibratedValue=False)


def written(root: Element) -> str:
    """Write a document, indented."""
    ElementTree.indent(root)
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ElementTree.tostring(root, encoding='unicode')}\n"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return _UNFIT.sub("\ufffd", str(value))

"""YAML of mappings, lists and scalars, and texts that cannot leave their place in compiled code."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

Node = Any
"""What a document holds: a text, a whole number, a truth value, a list, or a mapping."""
Type = dict[str, Node]
"""A type of Kaitai Struct."""

_PLAIN = re.compile(r"-?[a-z][a-z0-9_-]*")
_NOT_TEXT = {"false", "n", "no", "null", "off", "on", "true", "y", "yes"}
"""Words that are no strings in some version of YAML."""


def yaml_text(node: Mapping[str, Node]) -> str:
    """Write a mapping as a document in block style."""
    return "".join(f"{line}\n" for line in _lines(node))


def plain_text(text: str) -> str:
    """Text of one line that ends neither a string nor a comment in any language.

    The compiler copies documentation into comments and into strings of Python as it is.
    """
    line = "".join(char if char.isprintable() else "\ufffd" for char in " ".join(text.split()))
    return line.replace("\\", "/").replace('"', "'").replace("*/", "* /").replace("'''", "' ' '")


def _lines(node: Node) -> Iterator[str]:
    if isinstance(node, Mapping):
        for key, value in node.items():
            if isinstance(value, str | int):
                yield f"{_scalar(key)}: {_scalar(value)}"
            else:
                yield f"{_scalar(key)}:"
                yield from (f"  {line}" for line in _lines(value))
    elif isinstance(node, list):
        for item in node:
            first, *others = _lines(item)
            yield f"- {first}"
            yield from (f"  {line}" for line in others)
    else:
        yield _scalar(node)


def _scalar(value: str | int) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int) or (_PLAIN.fullmatch(value) and value not in _NOT_TEXT):
        return str(value)
    return json.dumps(value, ensure_ascii=False)

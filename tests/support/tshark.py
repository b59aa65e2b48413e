"""tshark with a generated dissector: the fields that it shows of each record."""

from __future__ import annotations

import subprocess
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from waiting import LIMIT_S

Fields = dict[str, Any]
"""Fields by name; None for no value; of beams a list of such."""


def dissect(script: Path, capture: Path, protocol: str, *options: str) -> list[list[Fields]]:
    """For each record of a capture the fields of the protocol's messages in it.

    A field `beam` with a subtree becomes an entry of the list `beams`; expert information the entry `problem`.
    """
    command = ["tshark", "-X", f"lua_script:{script}", "-r", str(capture), "-T", "pdml", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    assert "Lua" not in done.stderr, done.stderr
    assert "Lua Error" not in done.stdout
    records = ElementTree.fromstring(done.stdout).iter("packet")
    return [
        [_fields(each, protocol) for each in record.findall(f"proto[@name='{protocol}']")]
        for record in records
    ]


def _fields(tree: ElementTree.Element, protocol: str) -> Fields:
    values: Fields = {"beams": []}
    for item in tree.findall("field"):
        name = item.get("name", "")
        if name == "_ws.expert":
            values["problem"] = item.get("show") or item.find("field").get("name")  # type: ignore[union-attr]
            continue
        key = name.removeprefix(f"{protocol}.").rpartition(".")[2]
        if name.endswith(".none"):
            values[name.split(".")[-2]] = None
        elif name == f"{protocol}.beam" and item.find("field") is not None:
            values["beams"].append(_fields(item, protocol))
        else:
            values[key] = _value(item.get("show", ""))
        if problem := item.find("field[@name='_ws.expert']"):
            values["problem"] = problem[0].get("name")
    return values


def _value(text: str) -> int | float | str:
    for kind in (int, lambda digits: int(digits, 16), float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"True": 1, "False": 0}.get(text, text)


def messages(records: Sequence[Sequence[Fields]]) -> list[Fields]:
    """All messages, in order."""
    return [message for record in records for message in record]

"""Enumerations of the interface in Kaitai Struct."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from lidar_icd.kaitai.headers import KINDS, kinds
from lidar_icd.kaitai.identifiers import TYPE_NAMES, Identifiers, identifier
from lidar_icd.kaitai.yaml_text import Node, plain_text
from lidar_protocol.definitions import Interface


def enum_names(interface: Interface, types: Iterable[str]) -> dict[str, str]:
    """Identifiers of the enumerations that have words; none is the identifier of a type."""
    scope = Identifiers({*TYPE_NAMES, *types, KINDS})
    return {name: scope.add(name) for name, words in interface.enumerations.items() if words}


def enums(interface: Interface, names: Mapping[str, str]) -> dict[str, Node]:
    """All enumerations. In C++ their words are in one scope, behind the names of the enumerations."""
    of_kinds = {"unknown": 0} | {kind: code for code, kind in enumerate(kinds(interface), 1)}
    scope = Identifiers()
    made = {KINDS: _words(of_kinds, KINDS, scope)}
    for enumeration, name in names.items():
        made[name] = _words(interface.enumerations[enumeration], name, scope)
    return made


def _words(words: Mapping[str, int], name: str, scope: Identifiers) -> dict[int, Node]:
    made: dict[int, Node] = {}
    for word, code in words.items():
        if code not in made:
            own = scope.add(f"{name}_{identifier(word)}").removeprefix(f"{name}_")
            made[code] = own if own == word else {"id": own, "-orig-id": plain_text(word)}
    return made

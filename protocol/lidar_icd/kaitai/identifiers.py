"""Identifiers of Kaitai Struct, which become names in the languages that its compiler writes."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable

_WORDS = {word.lower() for word in keyword.kwlist} | {
    "alignas", "alignof", "asm", "auto", "bitand", "bitor", "bool", "case", "catch", "char", "compl", "const",
    "constexpr", "decltype", "default", "delete", "do", "double", "enum", "explicit", "export", "extern", "float",
    "friend", "goto", "inline", "int", "long", "mro", "mutable", "namespace", "new", "noexcept", "nullptr", "operator",
    "private", "protected", "public", "register", "self", "short", "signed", "sizeof", "static", "struct", "switch",
    "template", "this", "throw", "typedef", "typename", "union", "unsigned", "using", "virtual", "void", "volatile",
    "xor",
}  # fmt: skip
"""Words of Python and C++, and `mro`, which is no member of an enumeration in Python."""

TYPE_NAMES = frozenset(
    {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
    | {"size", "int_enum", "kaitai_struct", "kaitai_stream", "lidar_stream"}
)
"""Types and enumerations that would hide one that compiled code uses: `int8` becomes `int8_t` in C++."""


def identifier(text: str) -> str:
    """Text in lower snake case, and no word of a language."""
    name = re.sub("[^a-z0-9]+", "_", text.lower()).strip("_")
    if not name[:1].isalpha():
        name = f"id_{name}".rstrip("_")
    return f"{name}_value" if name in _WORDS else name


class Identifiers:
    """The identifiers of one scope."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._names, self._letters = set(taken), {name.replace("_", "") for name in taken}

    def add(self, text: str) -> str:
        """Take the identifier of a text, with a number where its name in a language is taken."""
        base, number = identifier(text), 1
        name = base
        while self._is_taken(name):
            number += 1
            name = f"{base}_{number}"
        self._names |= _names_in_languages(name)
        self._letters.add(name.replace("_", ""))
        return name

    def _is_taken(self, name: str) -> bool:
        return name.replace("_", "") in self._letters or not self._names.isdisjoint(_names_in_languages(name))


def _names_in_languages(name: str) -> set[str]:
    """The name, and the names of the members that hold its value and its state in C++."""
    return {name, *(f"{letter}_{name}" for letter in "fmn")}

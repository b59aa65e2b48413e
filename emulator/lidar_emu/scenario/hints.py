"""What the author of a wrong key probably meant. Computed for errors alone."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from lidar_emu.errors import nearest
from lidar_emu.scenario.section import LIMITS
from lidar_emu.scenario.yaml_text import Key, dotted, read_mapping

Node = dict[str, Any]

_SHIPPED = Path(__file__).resolve().parents[1] / "shipped"
_PREFIXES = {"k": 1e3, "m": 1e-3, "u": 1e-6, "n": 1e-9, "M": 1e6, "G": 1e9, "T": 1e12, "c": 1e-2}
_STRONG = 0.85  # likeness of two spellings of one name
_LONGEST_EXAMPLE = 40


def meant_key(schema: Node, tree: Any, place: Key, here: Iterable[str], name: str) -> Key | None:
    """The key that an unknown one was meant to be: one that differs by a letter or the unit, or lies elsewhere.

    Args:
        schema: JSON schema of the model.
        tree: the refused scenario; the kinds that it chooses decide which keys there are.
        place: key of the mapping with the unknown key.
        here: keys that this mapping may have.
        name: the unknown key.
    """
    beside = [(*place, key) for key in here]
    if near := _alike(name, beside, place, _STRONG):
        return near
    elsewhere = list(_known_keys(schema, tree, (), schema.get("$defs", {})))
    unknown: Any = tree
    for step in (*place, name):
        unknown = unknown[step]
    leaf = ""
    while isinstance(unknown, dict) and len(unknown) == 1:  # as of `--set laser.linewidth_hz=1e4`
        ((leaf, unknown),) = unknown.items()
    return (
        ("_" in leaf and _alike(leaf, elsewhere, place, _STRONG))  # many mappings have a name or a file
        or _alike(name, elsewhere, place, _STRONG)
        or _alike(name, beside, place, max(0.6, 1 - 1.01 / (len(name) or 1)))  # one letter of a short name
    )


def key_of_option(schema: Node, name: str, options: Iterable[str]) -> str | None:
    """The dotted key that an unknown option is named after, such as `timing.rate_hz` for `rate_hz` or `rate`, unless
    one of the command's options is."""
    stem = _stem(name)
    keys = [key for key in _known_keys(schema, {}, (), schema["$defs"]) if _stem(str(key[-1])) == stem]
    return None if stem in options else dotted(_alike(name, keys, (), _STRONG) or ())


def _alike(name: str, keys: list[Key], place: Key, cutoff: float) -> Key | None:
    """The key whose name is most like `name`, nearest to `place`."""
    names = {str(key[-1]): _stem(str(key[-1])) for key in keys}
    stem = _stem(name)
    same = [key for key in names if names[key] == stem]
    if len(stem) > 3:
        same = same or [key for key in names if names[key].endswith(f"_{stem}")]
    stems = {names[key]: key for key in names}
    near_stem = nearest(name, stems, _STRONG) or ""
    near = nearest(name, same or names, 0.0 if same else cutoff) or stems.get(near_stem)
    found = (key for key in keys if key[-1] == near)
    shared = range(len(place) + 1)
    return max(found, key=lambda key: (sum(key[:n] == place[:n] for n in shared), -len(key)), default=None)


def _stem(name: str) -> str:
    """A name without its unit: `altitude` of `altitude_km`."""
    stem, _, unit = name.rpartition("_")
    is_unit = unit in LIMITS or (unit[:1] in _PREFIXES and unit[1:] in LIMITS)
    return stem if stem and is_unit else name


def in_unit_of(meant: str, name: str, value: object) -> float | None:
    """A value in the unit of the key that was meant, where the unknown key differs by the unit's prefix alone."""
    unit, stated = meant.rpartition("_")[2], name.rpartition("_")[2]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and stated[:1] in _PREFIXES and stated[1:] == unit):
        return None
    return value * _PREFIXES[stated[0]]  # type: ignore[operator]


def _known_keys(node: Node, value: Any, key: Key, definitions: Node) -> Iterator[Key]:
    """All keys at and below a place, in the entries that the lists have, and of the kinds that are chosen."""
    for choice in alternatives(node, definitions):
        if isinstance(value, list) and isinstance(items := choice.get("items"), dict):
            for k, entry in enumerate(value):
                yield from _known_keys(items, entry, (*key, k), definitions)
        properties = choice.get("properties", {})
        stated = value if isinstance(value, dict) else {}
        if properties.get("kind", {}).get("const") in (None, stated.get("kind")):
            for name, below in properties.items():
                yield (*key, name)
                is_left_out = name not in stated and below.get("default", ...) is None
                if not is_left_out:
                    yield from _known_keys(below, stated.get(name), (*key, name), definitions)


def alternatives(node: Node, definitions: Node) -> Iterator[Node]:
    """A schema, and all that it refers to or chooses from."""
    yield node
    if "$ref" in node:
        yield from alternatives(definitions[node["$ref"].rpartition("/")[2]], definitions)
    for choice in (*node.get("oneOf", ()), *node.get("anyOf", ())):
        yield from alternatives(choice, definitions)


@cache
def shipped_example(key: tuple[str, ...], kind: str | None) -> str | None:
    """A short value of a key, in a mapping of this kind, from what is shipped; None if there is none."""
    for below, folder in ((key[1:], f"{key[0]}s"), (key, "scenarios"), (key, "campaigns")):
        for file in sorted((_SHIPPED / folder).glob("*.yaml")):
            for value in _stated_values(read_mapping(file), below, kind):
                text = json.dumps(value).strip('"')
                if len(text) <= _LONGEST_EXAMPLE:
                    return text
    return None


def _stated_values(node: Any, key: tuple[str, ...], kind: str | None) -> Iterator[Any]:
    if isinstance(node, list):
        for entry in node:
            yield from _stated_values(entry, key, kind)
    elif isinstance(node, dict) and key and node.get(key[0]) is not None:
        if key[1:]:
            yield from _stated_values(node[key[0]], key[1:], kind)
        elif node.get("kind") == kind:
            yield node[key[0]]

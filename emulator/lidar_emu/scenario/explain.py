"""The first validation error of a scenario as one line: file, key, what it must be, and what was found."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from lidar_emu.errors import Finding, InputError, did_you_mean, listed, nearest
from lidar_emu.scenario.hints import Node, alternatives, in_unit_of, meant_key, shipped_example
from lidar_emu.scenario.yaml_text import Key, Tree, dotted

_WHOLE = "a whole number (no point or exponent)"
_LIST = "a list"
_MAPPING = "a mapping of keys to values"
_INSTANT = "an instant such as 2030-01-01T12:00:00Z"
_ON_THE_PAGE = " in docs/scenario-reference.md"
_MISSING, _UNKNOWN = "missing", "extra_forbidden"
_NO_KIND, _OTHER_KIND = "union_tag_not_found", "union_tag_invalid"
_WORDS = {
    "float_type": "a number",
    "int_type": _WHOLE,
    "int_from_float": _WHOLE,
    "string_type": "text (a number in quotes)",
    "bool_type": "on or off",
    "list_type": _LIST,
    "tuple_type": _LIST,
    "dict_type": _MAPPING,
    "model_type": _MAPPING,
    "model_attributes_type": _MAPPING,
}


_Model = TypeVar("_Model", bound=BaseModel)


class Source(NamedTuple):
    """Where a key is stated: a file or an option, and how many leading steps of the key lie outside it."""

    name: str
    outer: int = 0


def source_of(key: Key, sources: Mapping[Key, Source]) -> Source:
    """Where the key, or the nearest mapping around it, is stated."""
    return sources[max((start for start in sources if key[: len(start)] == start), key=len)]


def validated(model: type[_Model], tree: Tree, sources: Mapping[Key, Source]) -> _Model:
    """The model of keys and values; `sources` names the file that states each key.

    Raises:
        InputError: names the file, the key, the value that cannot be used, and what can.
    """
    try:
        return model.model_validate_json(json.dumps(tree))
    except ValidationError as error:
        raise _explained(error, model, tree, sources) from None


def _explained(
    error: ValidationError, model: type[BaseModel], tree: Tree, sources: Mapping[Key, Source]
) -> InputError:
    """The first error of `model` in `tree`; `sources` names the file that states each key."""
    details = error.errors(include_url=False)
    first = _first_cause(details)
    key = _place(tree, first)
    source = source_of(key, sources)
    name = dotted(key[source.outer :])
    nodes = list(_schema_at(model, first["loc"]))
    value = _value_at(tree, key)
    match first["type"]:
        case "unusable":
            found = first["ctx"]["value"]
            found = found if value is None or isinstance(found, Finding) else value
            expected = first["ctx"]["expected"]
            remedy = expected if isinstance(found, Finding) else f"must be {expected}"
            checked = key[: -1 - first["ctx"]["key"].count(".")]
            if source.outer and (change := _change_below(checked, source, sources)):
                remedy, source = f"{remedy}; {Path(source.name).name} states it", change
            return InputError(source.name, dotted(key[source.outer :]), found, remedy)
        case "missing":
            what = "key" if isinstance(key[-1], str) else "entry"
            remedy = f"this {what} is required{_example(tree, key, nodes)}"
            return InputError(source.name, name, Finding("missing"), remedy)
        case "extra_forbidden":
            remedy = _about_unknown(model, tree, key, first["loc"], source.outer)
            return InputError(source.name, name, Finding("no such key"), remedy)
        case "union_tag_invalid" | "union_tag_not_found":
            kinds = _kinds(nodes)
            choice = listed(kinds, " or ", _ON_THE_PAGE)
            if first["type"] == _NO_KIND:
                misspelled = nearest("kind", _value_at(tree, key[:-1]))
                renamed = f"rename {misspelled}, or " if misspelled else ""
                return InputError(source.name, name, Finding("missing"), f"{renamed}choose {choice}")
            hint = did_you_mean(nearest(str(value), kinds))
            return InputError(source.name, name, value, f"{hint}must be {choice}")
        case "too_short" | "too_long":
            found = Finding(f"a list of {len(value)}")
            return InputError(source.name, name, found, f"state {_length(first)}")
    # A value that fails a union fails each of its alternatives.
    together = dict.fromkeys(_words(one) for one in details if _place(tree, one) == key)
    return InputError(source.name, name, value, f"must be {', or '.join(together)}")


def _change_below(checked: Key, base: Source, sources: Mapping[Key, Source]) -> Source | None:
    """What changes a key of a mapping, so that another one, which a base states, does not go with it."""
    below = (one for key, one in sources.items() if len(key) > 1 and key[: len(checked)] == checked)
    return next((one for one in below if one != base), None)


def _example(tree: Tree, key: Key, nodes: list[Node]) -> str:
    """What a missing key may be: one of its words, or the value of a shipped scenario."""
    if words := [str(word) for node in nodes for word in node.get("enum", ())]:
        return f": {listed(words, ' or ')}"
    names = tuple(step for step in key if isinstance(step, str))
    mapping = _value_at(tree, key[:-1])
    example = shipped_example(names, mapping.get("kind") if isinstance(mapping, dict) else None)
    return "" if example is None else f", e.g. {names[-1]}: {example}"


def _about_unknown(model: type[BaseModel], tree: Tree, key: Key, location: Key, outer: int) -> str:
    """What an unknown key may have been meant to be, and the keys that are known in its place."""
    known = {name: None for node in _schema_at(model, location[:-1]) for name in node.get("properties", ())}
    outermost, dot, inner = str(key[-1]).partition(".")
    if dot and outermost in known:  # copied from a message, or from --set
        return f"nest it, as {outermost}: {{{inner.replace('.', ': {')}: ...{'}' * (inner.count('.') + 1)}"
    others = [node for node in _schema_at(model, location[:-2]) if key[-1] in node.get("properties", ())]
    if (kinds := _kinds(others)) and location[-2] != key[-2]:
        hint = f"a key of kind {listed(kinds, ' or ')}, not {location[-2]}; "
    else:
        meant = meant_key(_schema(model), tree, key[:-1], known, str(key[-1])) or ()
        # A part's file cannot state keys of other parts.
        found = dotted(meant[outer:]) if meant[:outer] == key[:outer] else None
        here = found and in_unit_of(str(meant[-1]), str(key[-1]), _value_at(tree, key))
        hint = did_you_mean(f"{found} ({here:g} here)" if here else found)
    return f"{hint}known here: {listed(known, rest=_ON_THE_PAGE)}"


def _first_cause(details: list[Any]) -> Any:
    """The first error; for a mistyped key, the unknown key rather than the missing one."""
    first = details[0]
    if first["type"] != _MISSING:
        return first
    beside = (one for one in details if one["type"] == _UNKNOWN and one["loc"][:-1] == first["loc"][:-1])
    return next(beside, first)


def _place(tree: Tree, detail: Any) -> Key:
    """The key in question: pydantic also names the kind that it chose in a union."""
    node: Any = tree
    key: list[str | int] = []
    just_entered = False
    for step in detail["loc"]:
        if just_entered and isinstance(node, dict) and step == node.get("kind"):
            just_entered = False
        elif _has(node, step):
            node = node[step]
            key.append(step)
            just_entered = True
    if detail["type"] == _MISSING:
        key.append(detail["loc"][-1])
    if detail["type"] in (_NO_KIND, _OTHER_KIND):
        key.append("kind")
    if detail["type"] == "unusable":
        key += [int(step) if step.isdecimal() else step for step in detail["ctx"]["key"].split(".")]
    return tuple(key)


def _has(node: Any, step: str | int) -> bool:
    if isinstance(node, list):
        return isinstance(step, int) and step < len(node)
    return isinstance(node, dict) and step in node


def _value_at(tree: Tree, key: Key) -> Any:
    node: Any = tree
    for step in key:
        node = node[step] if _has(node, step) else None
    return node


def _words(detail: Any) -> str:
    kind = str(detail["type"])
    if kind.startswith(("datetime", "timezone")):
        return _INSTANT
    return _WORDS.get(kind) or detail["msg"].removeprefix("Input should be ")


def _length(detail: Any) -> str:
    if detail["type"] == "too_short":
        return f"at least {detail['ctx']['min_length']}"
    return f"at most {detail['ctx']['max_length']}"


def _schema_at(model: type[BaseModel], location: Key) -> Iterator[Node]:
    """The JSON schemas that apply at a location in pydantic's notation."""
    schema = _schema(model)
    nodes = list(alternatives(schema, schema["$defs"]))
    for step in location:
        below = [child for node in nodes if (child := _child(node, step)) is not None]
        # A step that leads nowhere is the name of an alternative, and the alternatives are here already.
        nodes = [one for node in below for one in alternatives(node, schema["$defs"])] or nodes
    yield from nodes


@cache
def _schema(model: type[BaseModel]) -> Node:
    """Made once: it takes a quarter of a second, and a campaign may have thousands of errors."""
    return model.model_json_schema()


def _child(node: Node, step: str | int) -> Node | None:
    below: Node = node.get("properties", {})
    if below.get("kind", {}).get("const") == step:
        return node
    child: Any = (
        node.get("items") if isinstance(step, int) else below.get(step, node.get("additionalProperties"))
    )
    return child if isinstance(child, dict) else None


def _kinds(nodes: list[Node]) -> list[str]:
    kinds = (node.get("properties", {}).get("kind", {}) for node in nodes)
    return [kind["const"] for kind in kinds if "const" in kind]

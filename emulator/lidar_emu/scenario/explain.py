"""The first validation error of a scenario as one line: file, key, what it must be, and what was found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.yaml_text import Key, Tree, dotted

_WHOLE = "a whole number (no point or exponent)"
_LIST = "a list"
_MAPPING = "a mapping of keys to values"
_INSTANT = "an instant such as 2030-01-01T12:00:00Z"
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


class Source(NamedTuple):
    """Where a key is stated: a file or an option, and how many leading steps of the key lie outside it."""

    name: str
    outer: int = 0


def source_of(key: Key, sources: Mapping[Key, Source]) -> Source:
    """Where the key, or the nearest mapping around it, is stated."""
    return sources[max((start for start in sources if key[: len(start)] == start), key=len)]


def explained(
    error: ValidationError, model: type[BaseModel], tree: Tree, sources: Mapping[Key, Source]
) -> InputError:
    """The first error of `model` in `tree`; `sources` names the file that states each key."""
    details = error.errors(include_url=False)
    first = _first_cause(details)
    key = _place(tree, first)
    source = source_of(key, sources)
    name = dotted(key[source.outer :])
    nodes = list(_schema_at(model, first["loc"][:-1] if first["type"] == _UNKNOWN else first["loc"]))
    value = _value_at(tree, key)
    match first["type"]:
        case "unusable":
            found = first["ctx"]["value"]
            found = found if value is None or isinstance(found, Finding) else value
            expected = first["ctx"]["expected"]
            return InputError(
                source.name, name, found, expected if isinstance(found, Finding) else f"must be {expected}"
            )
        case "missing":
            what = "key" if isinstance(key[-1], str) else "entry"
            return InputError(source.name, name, Finding("missing"), f"this {what} is required")
        case "extra_forbidden":
            return InputError(source.name, name, Finding("no such key"), f"known here: {_keys(nodes)}")
        case "union_tag_invalid" | "union_tag_not_found":
            if first["type"] == _NO_KIND:
                return InputError(source.name, name, Finding("missing"), f"choose {_kinds(nodes)}")
            return InputError(source.name, name, value, f"must be {_kinds(nodes)}")
        case "too_short" | "too_long":
            found = Finding(f"a list of {len(value)}")
            return InputError(source.name, name, found, f"state {_length(first)}")
    # A value that fails a union fails each of its alternatives.
    together = dict.fromkeys(_words(one) for one in details if _place(tree, one) == key)
    return InputError(source.name, name, value, f"must be {', or '.join(together)}")


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


def _schema_at(model: type[BaseModel], location: Key) -> Iterator[dict[str, Any]]:
    """The JSON schemas that apply at a location in pydantic's notation."""
    schema = _schema(model)
    nodes = list(_alternatives(schema, schema["$defs"]))
    for step in location:
        below = [child for node in nodes if (child := _child(node, step)) is not None]
        # A step that leads nowhere is the name of an alternative, and the alternatives are here already.
        nodes = [one for node in below for one in _alternatives(node, schema["$defs"])] or nodes
    yield from nodes


@cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    """Made once: it takes a quarter of a second, and a campaign may have thousands of errors."""
    return model.model_json_schema()


def _child(node: dict[str, Any], step: str | int) -> dict[str, Any] | None:
    below: dict[str, Any] = node.get("properties", {})
    if below.get("kind", {}).get("const") == step:
        return node
    child: Any = (
        node.get("items") if isinstance(step, int) else below.get(step, node.get("additionalProperties"))
    )
    return child if isinstance(child, dict) else None


def _alternatives(node: dict[str, Any], definitions: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield node
    if "$ref" in node:
        yield from _alternatives(definitions[node["$ref"].rpartition("/")[2]], definitions)
    for choice in (*node.get("oneOf", ()), *node.get("anyOf", ())):
        yield from _alternatives(choice, definitions)


def _keys(nodes: list[dict[str, Any]]) -> str:
    return ", ".join(dict.fromkeys(key for node in nodes for key in node.get("properties", ())))


def _kinds(nodes: list[dict[str, Any]]) -> str:
    kinds = [node["properties"]["kind"]["const"] for node in nodes if "properties" in node]
    return " or ".join([", ".join(kinds[:-1]), kinds[-1]] if len(kinds) > 1 else kinds)

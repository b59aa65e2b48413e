"""A shipped scenario or campaign as a file to change, with the meaning of each key from the schema beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from textwrap import shorten, wrap
from typing import Any

from lidar_emu.scenario.json_schema import Node, campaign_schema, choices, json_schema, target
from lidar_emu.scenario.load import read_scenario
from lidar_emu.scenario.parts import shipped, shipped_names
from lidar_emu.scenario.section import LIMITS
from lidar_emu.scenario.yaml_text import Tree, read_mapping

_SHOWN = (
    *("timing.rate_hz", "instrument.optics.laser_power_w", "instrument.detection.peak"),
    *("instrument.detection.combine", "site.surface.reflectance", "scanner.switches"),
    *("trajectory.file", "faults"),
)
"""Keys that are changed most often: written with their values where the shipped scenario leaves them to a part."""
_COLUMN, _ROOM = 40, 70
"""Where comments begin, and how wide they are."""
_LONGEST_SENTENCE = 150


def shipped_files() -> dict[str, Path]:
    """Scenarios and campaigns that come with the package, by name."""
    return {
        name: shipped(folder) / name
        for folder in ("scenarios", "campaigns")
        for name in shipped_names(folder)
    }


def commented_text(source: Path, name: str) -> str:
    """The text of a shipped scenario or campaign under another name, with a comment at each key."""
    tree = read_mapping(source)
    if source.parent.name == "campaigns":
        schema = campaign_schema()
    else:
        schema = json_schema()
        _show(tree, source)
    tree["name"] = name
    return "\n".join(_mapping(tree, schema, schema["$defs"], "")) + "\n"


def _show(tree: Tree, source: Path) -> None:
    """Add the keys that are changed most often, with the values that they have in the scenario."""
    values = read_scenario(source, []).model_dump(mode="json")
    for *parents, last in (dotted.split(".") for dotted in _SHOWN):
        stated: Any = values
        for name in parents:
            stated = stated.get(name, {})
        if last in stated:
            node = tree
            for name in parents:
                if isinstance(node.get(name), str):
                    node[name] = {"base": node[name]}
                node = node.setdefault(name, {})
            if last not in node or last == "file":  # which the scenario names relative to its folder
                node[last] = stated[last]


def _mapping(tree: Tree, node: Node, definitions: Node, indent: str) -> Iterator[str]:
    keys = _keys(tree, node, definitions)
    for key, value in tree.items():
        below = keys.get(key, {})
        comment = _comment(key, value, below)
        if isinstance(value, dict) and value and "." not in key:
            yield from _beside(f"{indent}{key}:", comment)
            yield from _mapping(value, below, definitions, indent + "  ")
        elif isinstance(value, list) and ("{" in _flow(value) or len(_flow(value)) > _ROOM):
            yield from _beside(f"{indent}{key}:", comment)
            yield from _list(value, below, definitions, indent + "  ")
        else:
            yield from _beside(f"{indent}{key}: {_flow(value)}", comment)


def _list(values: list[Any], node: Node, definitions: Node, indent: str) -> Iterator[str]:
    """An item a line, below the meanings of the keys in them."""
    items: Node = next((choice["items"] for choice in choices(node) if "items" in choice), {})
    meanings: Node = {}
    for item in (item for item in values if isinstance(item, dict)):
        meanings |= {key: below for key, below in _keys(item, items, definitions).items() if key in item}
    meanings.pop("kind", None)  # one for each item
    for key, below in meanings.items():
        lines = wrap(f"{key}: {_comment(key, None, below)}", _COLUMN + _ROOM - len(indent))
        yield from (f"{indent}# {line}" for line in lines)
    yield from (f"{indent}- {_flow(item)}" for item in values)


def _keys(tree: Tree, node: Node, definitions: Node) -> Node:
    """The schema of each key of a mapping; that of `kind` describes the kind, and lists all of them."""
    models = [definitions[target(each)] if "$ref" in each else each for each in choices(node)]
    models = [model for model in models if "properties" in model]
    kinds = [model["properties"].get("kind", {}).get("const") for model in models]
    for model, kind in zip(models, kinds, strict=True):
        keys: Node = model["properties"]
        if tree.keys() <= keys.keys() and kind in (None, tree.get("kind")):
            described = {"description": model["description"], "enum": list(dict.fromkeys(kinds))}
            return keys | ({"kind": described} if kind else {})
    return {}


def _comment(key: str, value: Any, node: Node) -> str:
    """Meaning of a key, words or shipped parts that it takes, and its unit."""
    sentence = re.split(r"(?<=\.)\s", " ".join(node.get("description", "").split()))[0]
    words = [shorten(sentence, _LONGEST_SENTENCE, placeholder=" ...")] if sentence else []
    for choice in choices(node):
        if isinstance(choice.get("enum", [None])[0], str):
            words.append(f"One of: {', '.join(choice['enum'])}.")
        if choice.get("examples") and not isinstance(value, dict):
            words.append(f"Shipped: {', '.join(choice['examples'])}.")
    limit = LIMITS.get(key.rpartition("_")[2])
    return " ".join([*words, f"[{limit.unit}]"] if limit and "_per_" not in key else words)


def _beside(text: str, comment: str) -> Iterator[str]:
    first, *others = wrap(comment, _ROOM, break_on_hyphens=False) or [""]
    yield f"{text:{_COLUMN - 1}} # {first}" if first else text
    yield from (f"{'':{_COLUMN}}# {line}" for line in others)


def _flow(value: Any) -> str:
    """A value in YAML's flow style."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_flow(item)}' for key, item in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_flow, value))}]"
    if isinstance(value, float):
        return f"{value:.12g}"
    is_plain = isinstance(value, str) and re.fullmatch(r"[A-Za-z]([\w./ -]*[\w.])?", value, re.ASCII)
    return value if is_plain and value.lower() not in ("true", "false", "null") else json.dumps(value)

"""Values that a Python program passes, as the plain values of a YAML file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import date
from os import PathLike, fspath
from typing import Any

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.parts import OVERRIDES, ChangedKey
from lidar_emu.scenario.section import Part
from lidar_emu.scenario.yaml_text import MAXIMUM_DEPTH, Tree, check_values, parse


def plain_mapping(values: Mapping[Any, Any], where: str) -> Tree:
    """A mapping as the keys and values of a YAML file; numpy's numbers and arrays become numbers and lists.

    Raises:
        InputError: names `where`, the key and a value that no key takes.
    """
    tree: Tree = _plain(values, where, 0)
    check_values(tree, where)
    return tree


def changed_keys(overrides: Mapping[str, Any] | None, keywords: Mapping[str, Any]) -> list[ChangedKey]:
    """The changes that a caller states, parents first, so that a key within a part can be changed with the part.

    Args:
        overrides: dotted keys and values; text is read as YAML, as on the command line.
        keywords: keys and values of a call.

    Raises:
        InputError: the overrides are no mapping, or a key or a value is not plain.
    """
    if not isinstance(overrides, Mapping | None):
        remedy = 'must be a mapping of dotted keys to values, such as {"timing.rate_hz": 100}'
        raise InputError(OVERRIDES, None, overrides, remedy)
    stated: Tree = {}
    for key, value in {**(overrides or {}), **keywords}.items():
        if not isinstance(key, str):
            raise InputError(OVERRIDES, None, key, "must be text, as a key")
        stated[key] = parse(value, f"{OVERRIDES}: {key}") if isinstance(value, str) else value
    values = plain_mapping(stated, OVERRIDES)
    return sorted((ChangedKey(key, values[key], OVERRIDES) for key in values), key=_depth)


def _depth(change: ChangedKey) -> int:
    return change.key.count(".")


def _plain(value: Any, where: str, depth: int) -> Any:
    if depth > MAXIMUM_DEPTH:
        raise InputError(where, None, Finding("nested too deeply"), f"nest at most {MAXIMUM_DEPTH} deep")
    if isinstance(value, Part):
        return value.model_dump(mode="json", exclude_unset=True)
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, date):
        return value.isoformat()
    if not isinstance(value, type) and callable(getattr(value, "tolist", None)):
        value = value.tolist()  # of numpy, without importing it
    if isinstance(value, Mapping):
        return {key: _plain(item, where, depth + 1) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return _plain_list(value, where, depth)
    return value


def _plain_list(values: Iterable[Any], where: str, depth: int) -> list[Any]:
    return [_plain(item, where, depth + 1) for item in values]

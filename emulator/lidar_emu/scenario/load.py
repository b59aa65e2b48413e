"""Reading a scenario: YAML files with parts by reference, checked once, here.

YAML 1.2 is read: `1e6` is a number and `12:30:45` is text, as an author means them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from lidar_emu.errors import InputError, one_line
from lidar_emu.scenario.schema import BenchScenario, FlightScenario

Tree = dict[str, Any]
Key = tuple[str | int, ...]

PART_FOLDERS = {
    "instrument": "instruments",
    "site": "sites",
    "trajectory": "trajectories",
    "scanner": "scanners",
    "bench_pattern": "bench_patterns",
}
_FILE_KEYS: tuple[tuple[str, ...], ...] = (("ground", "file"), ("file",))
_MAXIMUM_BYTES = 1_000_000
_MAXIMUM_NODES = 100_000
_MAXIMUM_DEPTH = 32


def shipped(folder: str) -> Path:
    """A folder of files that come with the package."""
    return Path(str(files("lidar_emu"))) / "shipped" / folder


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that come with the package."""
    return sorted(path.name for path in shipped("scenarios").glob("*.yaml"))


def load(scenario: str | Path, overrides: Mapping[str, str] | None = None) -> FlightScenario | BenchScenario:
    """Read and check a scenario.

    Args:
        scenario: path of a YAML file, or the name of a shipped one (`descent.yaml` or `descent`).
        overrides: dotted keys and YAML values that replace what the file says, e.g. `{"timing.rate_hz": "100"}`.

    Raises:
        InputError: names the file, key and value that cannot be used, and what is allowed.
    """
    path = _find_scenario(Path(scenario))
    tree = _read_mapping(path)
    sources: dict[Key, str] = {(): str(path)}
    for key, text in (overrides or {}).items():
        _override(tree, key, text, sources)
    for part in PART_FOLDERS:
        if part in tree:
            tree[part] = _resolve_part(part, tree[part], path, sources)
    model = BenchScenario if "bench_pattern" in tree else FlightScenario
    try:
        return model.model_validate_json(json.dumps(tree, default=_timestamp))
    except ValidationError as error:
        raise _explained(error, tree, sources) from None


def _find_scenario(given: Path) -> Path:
    if given.is_file():
        return given
    for name in (given.name, given.name + ".yaml"):
        if given.parent == Path() and name in shipped_scenarios():
            return shipped("scenarios") / name
    if given.exists():
        raise InputError(str(given), None, "a folder", "allowed: a YAML file")
    raise InputError(
        str(given),
        None,
        "no such file",
        f"allowed: a path to a YAML file, or one of those shipped: {', '.join(shipped_scenarios())}",
    )


def _read_mapping(path: Path) -> Tree:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            str(path), None, error.strerror or "unreadable", "allowed: a readable file"
        ) from None
    if len(data) > _MAXIMUM_BYTES:
        raise InputError(str(path), None, f"{len(data)} bytes", f"allowed: at most {_MAXIMUM_BYTES}")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise InputError(str(path), None, "not UTF-8 text", "allowed: a YAML file") from None
    tree = _parse(text, str(path))
    if not isinstance(tree, dict):
        raise InputError(str(path), None, tree, "allowed: a mapping of keys to values")
    return tree


def _parse(text: str, where: str) -> Any:
    """`text` as YAML 1.2; anchors that expand beyond reason are refused."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        tree = YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, TypeError, RecursionError) as error:
        raise InputError(where, _line_of(error), _problem_of(error), "allowed: YAML 1.2") from None
    for count, depth in enumerate(_depths(tree, 1)):
        if depth > _MAXIMUM_DEPTH or count > _MAXIMUM_NODES:
            raise InputError(
                where,
                None,
                "nested or repeated aliases",
                f"allowed: at most {_MAXIMUM_NODES} values, {_MAXIMUM_DEPTH} deep",
            )
    return tree


def _problem_of(error: Exception) -> str:
    return one_line(getattr(error, "problem", None) or str(error)) or type(error).__name__


def _line_of(error: Exception) -> str | None:
    mark = getattr(error, "problem_mark", None)
    return None if mark is None else f"line {mark.line + 1}"


def _depths(node: Any, depth: int) -> Iterator[int]:
    yield depth
    if depth > _MAXIMUM_DEPTH:
        return
    children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    for child in children:
        yield from _depths(child, depth + 1)


def _override(tree: Tree, key: str, text: str, sources: dict[Key, str]) -> None:
    """Set one dotted key; a part that is named by reference keeps its reference as `base`."""
    steps: list[str | int] = [int(step) if step.isdigit() else step for step in key.split(".")]
    node: Any = tree
    for depth, step in enumerate(steps[:-1]):
        child = _child(node, step, key)
        if depth == 0 and isinstance(child, str) and step in PART_FOLDERS:
            child = node[step] = {"base": child}
        elif child is None:
            child = node[step] = {}
        node = child
    _child(node, steps[-1], key)
    node[steps[-1]] = _parse(text, f"--set {key}")
    sources[tuple(steps)] = "--set"


def _child(node: Any, step: str | int, key: str) -> Any:
    if isinstance(node, dict):
        return node.get(step)
    if isinstance(node, list) and isinstance(step, int) and step < len(node):
        return node[step]
    raise InputError("--set", key, step, "allowed: a key below a mapping, or an index into a list")


def _resolve_part(part: str, value: Any, owner: Path, sources: dict[Key, str]) -> Any:
    """A part given in place, by the name of a file, or as a `base` file with keys that replace its own."""
    if isinstance(value, str):
        path = _find_part(part, value, owner)
        sources.setdefault((part,), str(path))
        return _with_absolute_files(_read_mapping(path), path.parent)
    if isinstance(value, dict) and "base" in value:
        base = _find_part(part, str(value["base"]), owner)
        own = _with_absolute_files({k: v for k, v in value.items() if k != "base"}, owner.parent)
        for key in own:
            sources.setdefault((part, key), sources[()])
        sources.setdefault((part,), str(base))
        return _merged(_with_absolute_files(_read_mapping(base), base.parent), own)
    return _with_absolute_files(value, owner.parent) if isinstance(value, dict) else value


def _find_part(part: str, name: str, owner: Path) -> Path:
    folders = (owner.parent, shipped(PART_FOLDERS[part]))
    for folder in folders:
        for candidate in (folder / name, folder / f"{name}.yaml"):
            if candidate.is_file():
                return candidate
    known = ", ".join(sorted(path.stem for path in folders[1].glob("*.yaml"))) or "none"
    raise InputError(
        str(owner), part, name, f"allowed: a file beside the scenario, or one of those shipped: {known}"
    )


def _merged(base: Tree, own: Tree) -> Tree:
    """`own` laid over `base`, mappings key by key; a mapping of another `kind` replaces the base's."""
    result = dict(base)
    for key, value in own.items():
        old = result.get(key)
        if (
            isinstance(value, dict)
            and isinstance(old, dict)
            and value.get("kind", old.get("kind")) == old.get("kind")
        ):
            result[key] = _merged(old, value)
        else:
            result[key] = value
    return result


def _with_absolute_files(tree: Tree, folder: Path) -> Tree:
    """File names in a part are relative to the file that states them, or name shipped ground."""
    for keys in _FILE_KEYS:
        node: Any = tree
        for key in keys[:-1]:
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, dict) and isinstance(node.get(keys[-1]), str):
            beside = folder / node[keys[-1]]
            own = shipped("ground") / node[keys[-1]]
            node[keys[-1]] = str(own if own.is_file() and not beside.exists() else beside)
    return tree


def _timestamp(value: object) -> str:
    """YAML timestamps arrive as UTC without a zone."""
    text = value.isoformat() if hasattr(value, "isoformat") else str(value)
    return text + "Z" if "T" in text and not text.endswith("Z") and "+" not in text else text


def _explained(error: ValidationError, tree: Tree, sources: Mapping[Key, str]) -> InputError:
    """The first complaint of pydantic as file, key, value and what is allowed."""
    first = error.errors()[0]
    location, value = _walked(tree, first["loc"], missing=first["type"] == "missing")
    prefix = max((key for key in sources if location[: len(key)] == key), key=len)
    where, message = sources[prefix], first["msg"].removeprefix("Value error, ").removeprefix("Input ")
    inside_part = where != "--set" and where != sources[()] and len(prefix) == 1
    key = ".".join(str(step) for step in (location[1:] if inside_part else location)) or None
    if first["type"] == "missing":
        return InputError(where, key, "nothing", "allowed: this key is required")
    if first["type"] == "extra_forbidden":
        return InputError(where, key, value, "allowed: only the documented keys (lidar-emu schema)")
    if first["type"] == "value_error":
        return InputError(
            where, key, "the value" if isinstance(value, dict) else value, f"allowed: {message}"
        )
    return InputError(where, key, value, f"allowed: {message}")


def _walked(tree: Tree, location: tuple[str | int, ...], missing: bool) -> tuple[Key, Any]:
    """The location as keys of the tree: pydantic also names the kind that it chose in a union."""
    node: Any = tree
    keys: list[str | int] = []
    for place, step in enumerate(location):
        here = (isinstance(node, dict) and step in node) or (
            isinstance(node, list) and isinstance(step, int) and step < len(node)
        )
        if here:
            node = node[step]
            keys.append(step)
        elif missing and place == len(location) - 1:
            keys.append(step)
    return tuple(keys), node

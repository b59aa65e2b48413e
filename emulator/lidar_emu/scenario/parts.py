"""Parts of a scenario by reference, changed keys, and the check of the whole."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import date
from importlib.resources import files
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel

from lidar_emu.errors import Finding, InputError, did_you_mean, listed, nearest, shown
from lidar_emu.files import near_file
from lidar_emu.scenario.explain import Source, source_of, validated
from lidar_emu.scenario.section import Part
from lidar_emu.scenario.yaml_text import MAXIMUM_DEPTH, Key, Tree, check_values, dotted, parse, read_mapping

Sources = dict[Key, Source]
_Scenario = TypeVar("_Scenario", bound=BaseModel)

PART_FOLDERS = {
    "instrument": "instruments",
    "site": "sites",
    "trajectory": "trajectories",
    "scanner": "scanners",
    "bench_pattern": "bench_patterns",
}
OPTION, OVERRIDES, CAMPAIGN = "--set", "overrides", "campaign"
"""Where a changed key is stated: on the command line, in Python, in a campaign."""
_FILE_KEYS = (("ground", "file"), ("ground", "grids", "*", "file"), ("objects", "*", "file"), ("file",))
"""Where parts name files; `*` is every entry of a list."""


class ChangedKey(NamedTuple):
    """A dotted key with a value that replaces the scenario's."""

    key: str
    value: Any
    stated_by: str


def shipped(folder: str) -> Path:
    """A folder of files that come with the package."""
    return Path(str(files("lidar_emu"))) / "shipped" / folder


def shipped_names(folder: str) -> list[str]:
    """Names of the YAML files that come with the package in one of its folders."""
    return sorted(path.name for path in shipped(folder).glob("*.yaml"))


def is_true(check: Callable[[], bool]) -> bool:
    """Result of a check of the file system; False for a name that no file can have."""
    try:
        return check()
    except (OSError, ValueError):
        return False


def checked(
    tree: Tree, changes: Iterable[ChangedKey], model: type[_Scenario], owner: Path, where: str
) -> _Scenario:
    """The scenario of keys and values, with changed keys and its parts read from their files.

    Args:
        tree: keys and values; changed here.
        changes: keys that replace keys of the tree.
        model: a kind of scenario.
        owner: file in whose folder the files of parts are; its name does not matter.
        where: name of the scenario in messages.

    Raises:
        InputError: names the file, the key and what can be done.
    """
    sources: Sources = {(): Source(where)}
    for change in changes:
        _override(tree, *change, sources)
    _anchor_interface(tree, owner.parent, sources)
    for part in PART_FOLDERS:
        if part in tree:
            if part not in model.model_fields:
                where, found = source_of((part,), sources).name, Finding("given beside bench_pattern")
                raise InputError(where, part, found, "state bench_pattern, or the parts of a flight")
            tree[part] = _resolve_part(part, tree[part], owner, sources)
    return validated(model, tree, sources)


def _anchor_interface(tree: Tree, folder: Path, sources: Sources) -> None:
    """Resolve an interface's file relative to the scenario that names it; named by an option, to the working
    directory."""
    wire = tree.get("wire")
    if not isinstance(wire, dict) or source_of(("wire", "interface"), sources).name in (OPTION, OVERRIDES):
        return
    name = wire.get("interface")
    if isinstance(name, str) and name.endswith(".toml"):
        wire["interface"] = str(folder / name)


def _override(tree: Tree, key: str, value: Any, stated_by: str, sources: Sources) -> None:
    steps = key.split(".")
    if len(steps) > MAXIMUM_DEPTH:
        raise InputError(stated_by, key[:60], Finding(f"{len(steps)} steps"), f"use at most {MAXIMUM_DEPTH}")
    node: Any = tree
    for depth, name in enumerate(steps[:-1]):
        step = _step(node, name, key, stated_by)
        child = node.get(step) if isinstance(node, dict) else node[step]
        if depth == 0 and isinstance(child, str) and step in PART_FOLDERS:
            child = node[step] = {"base": child}
        elif child is None:
            child = node[step] = {}
            sources[_key(steps[: depth + 1])] = Source(stated_by)
        node = child
    node[_step(node, steps[-1], key, stated_by)] = value
    sources[_key(steps)] = Source(stated_by)


def _key(steps: list[str]) -> Key:
    return tuple(int(step) if step.isdecimal() else step for step in steps)


def _step(node: Any, name: str, key: str, stated_by: str) -> str | int:
    if isinstance(node, dict):
        return name
    if not isinstance(node, list):
        raise InputError(stated_by, key, name, "must be a key that has keys below it")
    return _index(node, name, key, stated_by)


def _index(entries: list[Any], name: str, key: str, stated_by: str) -> int:
    if name.isdecimal() and int(name) < len(entries):
        return int(name)
    raise InputError(stated_by, key, name, f"must be an index from 0 to {len(entries) - 1}")


def _resolve_part(part: str, value: Any, owner: Path, sources: Sources, opened: tuple[Path, ...] = ()) -> Any:
    """A part given in place, by the name of a file, or as a `base` file with keys that replace its own.

    `owner` is the file that states the value; `opened` are the files of this part on the way to it.
    """
    source = source_of((part,), sources)
    if isinstance(value, str):
        return _read_part(part, value, owner, sources, opened)
    if not isinstance(value, dict):
        raise InputError(
            source.name, part, value, "must be a mapping of keys to values, or the name of a file"
        )
    own = {key: item for key, item in value.items() if key != "base"}
    _anchor_files(own, owner.parent, source.name, dotted((part,)[source.outer :]))
    if "base" not in value:
        return own
    if not isinstance(value["base"], str):
        key = dotted((part, "base")[source.outer :])
        raise InputError(source.name, key, value["base"], "must be the name of a file")
    # From here on, keys below the part belong to the base, except these.
    for leaf in _leaves(own, (part,)):
        sources.setdefault(leaf, source_of(leaf, sources))
    return _merged(_read_part(part, value["base"], owner, sources, opened), own, (part,), sources)


def _read_part(part: str, name: str, owner: Path, sources: Sources, opened: tuple[Path, ...]) -> Any:
    path = _find_part(part, name, owner, source_of((part,), sources), opened)
    sources[(part,)] = Source(str(path), outer=1)
    return _resolve_part(part, read_mapping(path), path, sources, (*opened, path.resolve()))


def _find_part(part: str, name: str, owner: Path, source: Source, opened: tuple[Path, ...]) -> Path:
    """The file of a part; a file that is already open is not its own base, so that one beside the scenario may be
    based on the shipped one of the same name."""
    for folder in (owner.parent, shipped(PART_FOLDERS[part]), _own_folder(owner.parent)):
        for candidate in (folder / name, folder / f"{name}.yaml"):
            if is_true(candidate.is_file) and candidate.resolve() not in opened:
                return candidate
    known = [Path(each).stem for each in shipped_names(PART_FOLDERS[part])]
    near = near_file(owner.parent / f"{name.removesuffix('.yaml')}.yaml")
    hint = did_you_mean(nearest(name, known) if near is None else near.stem)
    found, place = ("no other such file", "this one") if opened else ("no such file", "the scenario")
    remedy = f"{hint}name a file beside {place}, or one of those shipped: {listed(known or ['none'])}"
    raise InputError(source.name, "base" if opened else part, Finding(f"{found}: {shown(name)}"), remedy)


def _own_folder(folder: Path) -> Path:
    """Folder in which a user keeps files: the working directory where `--set` changes a shipped scenario."""
    return Path() if folder == shipped("scenarios") else folder


def _leaves(node: Any, key: Key) -> list[Key]:
    if not (isinstance(node, dict) and node):
        return [key]
    return [leaf for step, child in node.items() for leaf in _leaves(child, (*key, step))]


def _merged(base: Any, own: Any, key: Key, sources: Sources) -> Any:
    """`own` laid over `base`, mappings key by key; a mapping of another `kind` replaces the base's.

    Overrides state entries of a list of the base by index.
    """
    if isinstance(base, list) and isinstance(own, dict) and own and all(map(str.isdecimal, own)):
        entries = {}
        for name, item in own.items():
            at = (*key, int(name))
            entries[_index(base, name, dotted(at) or "", source_of(at, sources).name)] = item
        return [_merged(old, entries.get(k, old), (*key, k), sources) for k, old in enumerate(base)]
    both_mappings = isinstance(base, dict) and isinstance(own, dict)
    if not both_mappings or own.get("kind", base.get("kind")) != base.get("kind"):
        if isinstance(own, dict):
            sources[key] = source_of(_leaves(own, key)[0], sources)
        return own
    return base | {name: _merged(base.get(name), item, (*key, name), sources) for name, item in own.items()}


def _anchor_files(tree: Tree, folder: Path, where: str, part: str | None) -> None:
    """File names in a part are relative to the file that states them, or name shipped ground."""
    for keys in _FILE_KEYS:
        for node, way in _nodes(tree, keys[:-1]):
            if isinstance(node, dict) and isinstance(node.get(keys[-1]), str):
                key = ".".join((*([part] if part else []), *way, keys[-1]))
                node[keys[-1]] = str(_anchored(node[keys[-1]], folder, where, key))


def _nodes(node: Any, keys: tuple[str, ...]) -> Iterator[tuple[Any, tuple[str, ...]]]:
    if not keys:
        yield node, ()
        return
    children = dict(enumerate(node)) if isinstance(node, list) else node if isinstance(node, dict) else {}
    for name, child in children.items():
        if keys[0] in ("*", name):
            yield from ((found, (str(name), *way)) for found, way in _nodes(child, keys[1:]))


def _anchored(name: str, folder: Path, where: str, key: str) -> Path:
    try:
        for shipped_or_beside in (folder / name, shipped("ground") / name):
            if shipped_or_beside.exists():
                return shipped_or_beside
        return _own_folder(folder) / name
    except OSError as error:
        raise InputError(where, key, Finding(f"{error.strerror}: {shown(name)}"), "name a file") from None


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
    parents_first = sorted(values, key=lambda key: key.count("."))
    return [ChangedKey(key, values[key], OVERRIDES) for key in parents_first]


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
        return [_plain(item, where, depth + 1) for item in value]
    return value

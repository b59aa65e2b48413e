"""YAML 1.2 as plain values: text, numbers, lists and mappings, of limited size.

`1e6` is a number and `12:30:45` is text, as an author means them; instants stay text for the schema to read.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import lru_cache
from itertools import accumulate
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import ConstructorError, SafeConstructor
from ruamel.yaml.nodes import MappingNode, ScalarNode

from lidar_emu.errors import Finding, InputError, one_line
from lidar_emu.files import read_bytes

MOST_CHARACTERS = 100


class LongNumber(str):
    """Text of a number of more than `MOST_CHARACTERS`, which no key takes."""

    __slots__ = ()


Tree = dict[str, Any]
Key = tuple[str | int, ...]

MAXIMUM_DEPTH = 32
_MAXIMUM_BYTES = 1_000_000
_RECORDING = b"\x89MCAP"
_MAXIMUM_NODES = 100_000
_MAXIMUM_MARKS = 20_000
"""Most colons, commas and dashes; each value needs one of them. Parsing this many takes about 3 s."""
_MAXIMUM_OPENED = 320
"""Open brackets and braces at a time. Parsing 10 000 takes seconds, in which a run that is sent such a fault stalls."""
_KINDS = (type(None), "an empty file"), (str, "text"), (list, "a list"), (object, "a single value")
_PLAIN = "must be text, a number, true, false, null, a list or a mapping"


def read_mapping(path: Path) -> Tree:
    """The keys and values of a file, or of a pipe, which can be read once.

    Raises:
        InputError: the file cannot be read, or is no mapping of plain values in YAML 1.2.
    """
    return deepcopy(_mapping(path, read_bytes(path, _MAXIMUM_BYTES, "use a readable YAML file")))


@lru_cache(maxsize=32)
def _mapping(path: Path, data: bytes) -> Tree:
    """Cached: repeated runs of a scenario read the same few files."""
    if data.startswith(_RECORDING):
        remedy = "lidar-emu report, replay or view takes it"
        raise InputError(str(path), None, Finding("a recording"), remedy)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(str(path), None, Finding("not UTF-8 text"), "use a YAML file") from None
    tree = parse(text, str(path))
    if not isinstance(tree, dict):
        # Its content is not shown: a scenario of somebody else may name a file that is not for its reader.
        found = Finding(next(name for kind, name in _KINDS if isinstance(tree, kind)))
        raise InputError(str(path), None, found, "state a mapping of keys to values")
    return tree


def parse(text: str, where: str) -> Any:
    """One YAML document as plain values.

    Raises:
        InputError: names `where`, and the line or key that cannot be used.
    """
    if (marks := sum(map(text.count, (":", ",", "- ")))) > _MAXIMUM_MARKS:
        found = Finding(f"{marks} colons, commas and dashes")
        raise InputError(
            where, None, found, f"use at most {_MAXIMUM_MARKS} values; a trajectory may be a CSV file"
        )
    if _opened(text) > _MAXIMUM_OPENED:
        raise InputError(where, None, Finding("nested too deeply"), f"nest at most {MAXIMUM_DEPTH} deep")
    try:
        with warnings.catch_warnings():
            # About numbers in files that declare themselves YAML 1.1.
            warnings.simplefilter("ignore")
            tree = read_values(text)
    except Exception as error:  # values with explicit tags may raise anything
        raise InputError(where, _line_of(error), _problem_of(error), _remedy(error)) from None
    check_values(tree, where)
    return tree


def _opened(text: str) -> int:
    """Most brackets and braces that are open at a time, those in texts and comments included."""
    steps = (1 if each in "[{" else -1 for each in re.findall(r"[][{}]", text))
    return max(accumulate(steps), default=0)


def dotted(key: Key) -> str | None:
    """A key as in `--set`; None for the whole."""
    return ".".join(str(step) for step in key) or None


def _problem_of(error: Exception) -> Finding:
    if isinstance(error, RecursionError):
        return Finding("nested too deeply")
    parts = [getattr(error, name, None) for name in ("context", "problem", "reason")]
    known = ", ".join(str(part) for part in parts if part)
    return Finding(one_line(known or str(error)) or type(error).__name__)


def _line_of(error: Exception) -> str | None:
    mark = getattr(error, "problem_mark", None)
    return None if mark is None else f"line {mark.line + 1}"


def _remedy(error: Exception) -> str:
    from ruamel.yaml.constructor import DuplicateKeyError

    return "state each key once" if isinstance(error, DuplicateKeyError) else "write YAML 1.2"


def check_values(tree: Any, where: str) -> None:
    """Refuse values that no key takes, and aliases that expand without bound."""
    for count, (key, node) in enumerate(_nodes(tree, ())):
        if len(key) >= MAXIMUM_DEPTH or count >= _MAXIMUM_NODES:
            limits = f"use at most {_MAXIMUM_NODES} values, nested {MAXIMUM_DEPTH} deep"
            raise InputError(where, dotted(key[:3]), Finding("nested or repeated too often"), limits)
        if isinstance(node, dict):
            for name in node:
                if not _is_text(name):
                    raise InputError(where, dotted(key), name, "must be text, as a key")
                if ":" in name:
                    raise InputError(where, dotted(key), name, "must have a space after the colon")
        elif isinstance(node, int):
            if not -(2**63) <= node < 2**63:
                raise InputError(where, dotted(key), node, "must be a whole number of up to 18 digits")
        elif isinstance(node, LongNumber):
            found = Finding(f"a number of {len(node)} characters")
            raise InputError(where, dotted(key), found, f"use at most {MOST_CHARACTERS}")
        elif not (node is None or isinstance(node, float | list) or _is_text(node)):
            raise InputError(where, dotted(key), node, _PLAIN)


def _is_text(value: object) -> bool:
    return isinstance(value, str) and "\0" not in value and not any("\ud800" <= c <= "\udfff" for c in value)


def _nodes(node: Any, key: Key) -> Iterator[tuple[Key, Any]]:
    yield key, node
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for step, child in children:
        yield from _nodes(child, (*key, step))


_MAXIMUM_MERGED_KEYS = 10_000


class _Constructor(SafeConstructor):
    """Leaves instants to the schema, which knows the time zone to assume."""

    merged_keys = 0

    def flatten_mapping(self, node: MappingNode) -> None:
        """Merge, within a limit: a few lines of nested `<<` can repeat keys without bound."""
        before = len(node.value)
        super().flatten_mapping(node)
        self.merged_keys += max(0, len(node.value) - before)
        if self.merged_keys > _MAXIMUM_MERGED_KEYS:
            raise ConstructorError(problem="merged too many keys", problem_mark=node.start_mark)


def _limited(
    construct: Callable[[SafeConstructor, ScalarNode], Any],
) -> Callable[[SafeConstructor, ScalarNode], Any]:

    def construct_number(constructor: SafeConstructor, node: ScalarNode) -> Any:
        is_long = isinstance(node, ScalarNode) and len(node.value) > MOST_CHARACTERS
        return LongNumber(node.value) if is_long else construct(constructor, node)

    return construct_number


_Constructor.add_constructor("tag:yaml.org,2002:int", _limited(SafeConstructor.construct_yaml_int))
_Constructor.add_constructor("tag:yaml.org,2002:float", _limited(SafeConstructor.construct_yaml_float))
_Constructor.add_constructor("tag:yaml.org,2002:timestamp", SafeConstructor.construct_yaml_str)


def read_values(text: str) -> Any:
    """One YAML 1.2 document."""
    yaml = YAML(typ="safe", pure=True)
    yaml.Constructor = _Constructor
    return yaml.load(text)

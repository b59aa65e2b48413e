"""Values of YAML nodes: instants stay text, merged keys are counted, and long numbers stay text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import ConstructorError, SafeConstructor
from ruamel.yaml.nodes import MappingNode, ScalarNode

from lidar_emu.scenario.long_number import MOST_CHARACTERS, LongNumber

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

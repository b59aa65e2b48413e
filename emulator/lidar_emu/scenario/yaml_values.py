"""Values of YAML nodes: instants stay text, merged keys are counted, and numbers are of limited length."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import ConstructorError, SafeConstructor
from ruamel.yaml.nodes import MappingNode, ScalarNode

_MAXIMUM_MERGED_KEYS = 10_000
_LONGEST_NUMBER = 100
"""Characters: Python takes the square of their number to read a whole number."""


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
    """Construct a number unless its text is longer than any number."""

    def construct_number(constructor: SafeConstructor, node: ScalarNode) -> Any:
        if len(node.value) > _LONGEST_NUMBER:
            problem = f"a number of {len(node.value)} characters"
            raise ConstructorError(problem=problem, problem_mark=node.start_mark)
        return construct(constructor, node)

    return construct_number


_Constructor.add_constructor("tag:yaml.org,2002:int", _limited(SafeConstructor.construct_yaml_int))
_Constructor.add_constructor("tag:yaml.org,2002:float", _limited(SafeConstructor.construct_yaml_float))
_Constructor.add_constructor("tag:yaml.org,2002:timestamp", SafeConstructor.construct_yaml_str)


def read_values(text: str) -> Any:
    """One YAML 1.2 document."""
    yaml = YAML(typ="safe", pure=True)
    yaml.Constructor = _Constructor
    return yaml.load(text)

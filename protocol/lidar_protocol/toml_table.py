"""Read a TOML table key by key, with error messages that name the place."""

from __future__ import annotations

import re
from collections.abc import Collection
from decimal import Decimal

from lidar_protocol.errors import DefinitionError

_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")


class TomlTable:
    """A table whose keys are taken one by one; `finish` refuses the remaining ones."""

    def __init__(self, where: str, value: object) -> None:
        if not isinstance(value, dict):
            raise DefinitionError(where, value, "a table")
        self.where = where
        self._left = dict(value)

    def __contains__(self, key: str) -> bool:
        return key in self._left

    def text(self, key: str, default: str | None = None) -> str:
        """A text; required without a default."""
        value = self._take(key, default, "a text")
        if not isinstance(value, str):
            raise self.refusal(key, value, "a text")
        return value

    def name(self, key: str) -> str:
        """A name that is valid in all generated languages and formats; required."""
        value = self.text(key)
        if not _NAME.fullmatch(value):
            raise self.refusal(
                key, value, "at most 32 lower-case letters, digits and underscores, the first a letter"
            )
        return value

    def choice(self, key: str, choices: Collection[str], default: str | None = None) -> str:
        """One of several texts; required without a default."""
        value = self._take(key, default, " or ".join(choices))
        if value not in choices:
            raise self.refusal(key, value, " or ".join(choices))
        return str(value)

    def boolean(self, key: str) -> bool:
        """`true` or `false`; false where left out."""
        value = self._take(key, False, "true or false")
        if not isinstance(value, bool):
            raise self.refusal(key, value, "true or false")
        return value

    def integer(self, key: str, lowest: int, highest: int, default: int | None = None) -> int:
        """A whole number from `lowest` to `highest`; required without a default."""
        expected = f"a whole number from {lowest} to {highest}"
        value = self._take(key, default, expected)
        if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
            raise self.refusal(key, value, expected)
        return value

    def optional_integer(self, key: str) -> int | None:
        """A whole number, or None where it is left out."""
        return self.integer(key, -(2**63), 2**64) if key in self else None

    def decimal(self, key: str) -> Decimal:
        """A number, exactly as written."""
        return self._as_decimal(key, self._take(key, None, "a number"))

    def decimal_pair(self, key: str) -> tuple[Decimal, Decimal]:
        """Two numbers in ascending order, exactly as written."""
        value = self._take(key, None, "two numbers")
        if not isinstance(value, list) or len(value) != 2:
            raise self.refusal(key, value, "two numbers")
        low, high = (self._as_decimal(key, item) for item in value)
        if low >= high:
            raise self.refusal(key, value, "two numbers in ascending order")
        return low, high

    def items(self, key: str) -> list[object]:
        """A non-empty list."""
        value = self._take(key, None, "a list")
        if not isinstance(value, list) or not value:
            raise self.refusal(key, value, "a list that is not empty")
        return value

    def table(self, key: str) -> TomlTable:
        """A table within this one."""
        return TomlTable(self._at(key), self._take(key, None, "a table"))

    def peek(self, key: str) -> TomlTable:
        """A table within this one, without taking it."""
        return TomlTable(self._at(key), self._left[key])

    def optional_table(self, key: str) -> TomlTable | None:
        """A table within this one, or None where it is left out."""
        return self.table(key) if key in self else None

    def optional_tables(self, key: str) -> list[TomlTable]:
        """A list of tables; empty where it is left out."""
        return self.tables(key) if key in self else []

    def tables(self, key: str) -> list[TomlTable]:
        """A list of tables."""
        return [TomlTable(f"{self._at(key)}[{place}]", item) for place, item in enumerate(self.items(key))]

    def names(self) -> list[str]:
        """Remaining keys."""
        return list(self._left)

    def rest(self) -> dict[str, object]:
        """Take all remaining keys."""
        rest, self._left = self._left, {}
        return rest

    def finish(self) -> None:
        """Refuse the remaining keys."""
        if self._left:
            raise DefinitionError(self.where, ", ".join(self._left), "a table of known keys")

    def refusal(self, key: str, value: object, expected: str) -> DefinitionError:
        """Error for the value of a key."""
        return DefinitionError(self._at(key), value, expected)

    def _at(self, key: str) -> str:
        return f"{self.where} {key}" if self.where.endswith(":") else f"{self.where}.{key}"

    def _take(self, key: str, default: object, expected: str) -> object:
        if key in self._left:
            return self._left.pop(key)
        if default is None:
            raise self.refusal(key, None, expected)
        return default

    def _as_decimal(self, key: str, value: object) -> Decimal:
        if isinstance(value, bool) or not isinstance(value, int | Decimal) or not Decimal(value).is_finite():
            raise self.refusal(key, value, "a finite number")
        return Decimal(value)

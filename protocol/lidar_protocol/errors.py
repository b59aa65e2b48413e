"""Errors, one class for each party at fault: author of the definition, caller, other end of the link."""

from __future__ import annotations

from enum import StrEnum


class DefinitionError(ValueError):
    """An interface definition cannot be used. The message is one line: place, what must be there, and the value."""

    def __init__(self, where: str, value: object, expected: str) -> None:
        super().__init__(where, value, expected)
        self.where, self.value, self.expected = where, value, expected

    def __str__(self) -> str:
        found = "missing" if self.value is None else f"got {self.value!r}"
        return " ".join(f"{self.where}: must be {self.expected} ({found})".split())


class UnknownKeyError(DefinitionError):
    """An interface definition has a key that is not known in its place; `expected` lists those that are."""

    def __str__(self) -> str:
        return f"{self.where}: no such key; {self.expected}"


class EncodeError(ValueError):
    """A value of the caller cannot be encoded."""


class Fault(StrEnum):
    """Fault of received bytes. The values are the names of the receivers' counters."""

    BAD_STUFFING = "bad_stuffing"
    BAD_LENGTH = "bad_length"
    BAD_CRC = "bad_crc"
    FOREIGN = "foreign"


class DecodeError(ValueError):
    """Received bytes are not a message of this interface."""

    def __init__(self, fault: Fault, text: str) -> None:
        super().__init__(text)
        self.fault = fault

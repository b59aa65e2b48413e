"""What can go wrong, told apart by whose fault it is."""

from __future__ import annotations

from enum import StrEnum


class DefinitionError(ValueError):
    """An interface definition cannot be used: one line with the place, the value and what is allowed."""

    def __init__(self, where: str, value: object, allowed: str) -> None:
        self.where, self.value, self.allowed = where, value, allowed
        found = "missing" if value is None else f"{value!r} is not usable"
        super().__init__(" ".join(f"{where}: {found}; allowed: {allowed}".split()))


class EncodeError(ValueError):
    """The caller gave something that cannot be sent."""


class Fault(StrEnum):
    """What is wrong with received bytes. The values are the names of the receivers' counters."""

    BAD_STUFFING = "bad_stuffing"
    BAD_LENGTH = "bad_length"
    BAD_CRC = "bad_crc"
    FOREIGN = "foreign"


class DecodeError(ValueError):
    """The other side sent something that is not a message of this interface."""

    def __init__(self, fault: Fault, text: str) -> None:
        super().__init__(text)
        self.fault = fault

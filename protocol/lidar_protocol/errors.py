"""Errors, one class for each party at fault: author of the definition, caller, other end of the link."""

from __future__ import annotations

from enum import StrEnum


class DefinitionError(ValueError):
    """An interface definition cannot be used. The message is one line: place, what is allowed and the value."""

    def __init__(self, where: str, value: object, allowed: str) -> None:
        self.where, self.value, self.allowed = where, value, allowed
        found = "missing" if value is None else f"got {value!r}"
        super().__init__(" ".join(f"{where}: must be {allowed} ({found})".split()))


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

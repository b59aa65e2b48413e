"""The two ways in which the tool can fail, told apart by whose fault it was."""

from __future__ import annotations


class InputError(Exception):
    """What the user gave cannot be used: one line that names file, key, value and what is allowed.

    The command line turns it into exit code 2. ``allowed`` completes the sentence "allowed: ...".
    """

    def __init__(self, where: str, key: str | None, value: object, allowed: str) -> None:
        self.where = where
        self.key = key
        self.value = value
        self.allowed = allowed
        super().__init__(str(self))

    def __str__(self) -> str:
        subject = f"{self.where}: {self.key}" if self.key else self.where
        return one_line(f"{subject}: {shown(self.value)} is not usable; {self.allowed}")


class RunError(Exception):
    """The run itself failed (a process died, a recording could not be written): exit code 1."""


def shown(value: object, limit: int = 60) -> str:
    """``value`` as a short piece of text for a message."""
    text = value if isinstance(value, str) else repr(value)
    text = f"{text!r}" if isinstance(value, str) else text
    return text if len(text) <= limit else text[: limit - 3] + "..."


def one_line(text: str) -> str:
    """``text`` with every run of white space made one blank."""
    return " ".join(text.split())

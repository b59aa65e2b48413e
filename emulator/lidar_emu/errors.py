"""The two errors that end a command, invalid input and a run that failed, and lines for the log."""

from __future__ import annotations

import json
import logging
from multiprocessing import parent_process

_noted = set[str]()


class InputError(Exception):
    """Invalid input: one line that names file, key, value and what to do about it; exit code 2.

    Args:
        where: the file, option or part of the input.
        key: dotted key in it; None: the input as a whole.
        value: what was found there; a `Finding` describes it in words.
        remedy: a predicate of the key, such as "must be a number"; beside a `Finding`, what can be done.
    """

    def __init__(self, where: str, key: str | None, value: object, remedy: str) -> None:
        super().__init__(where, key, value, remedy)
        self.where = where
        self.key = key
        self.value = value
        self.remedy = remedy

    def __str__(self) -> str:
        subject = f"{self.where}: {self.key}" if self.key else self.where
        if isinstance(self.value, Finding):
            return one_line(f"{subject}: {self.value}; {self.remedy}")
        return one_line(f"{subject}: {self.remedy} (got {shown(self.value)})")


class RunError(Exception):
    """The run itself failed (a process died, a recording could not be written): exit code 1."""


class Finding(str):
    """A description in place of a value, such as `no such file`; messages show it as it is."""

    __slots__ = ()


def shown(value: object, limit: int = 60) -> str:
    """Short text for a value in a message, much as an author would write it."""
    if not isinstance(value, str | bytes | float | int | list | tuple | dict | None):
        return f"a value of type {type(value).__name__}"
    try:
        text = (
            repr(value)
            if isinstance(value, str | float)
            else json.dumps(value, default=repr, ensure_ascii=False)
        )
    except (TypeError, ValueError):  # An integer of thousands of digits, or a list within itself.
        text = f"a value of type {type(value).__name__}"
    return text if len(text) <= limit else text[: limit - 3] + "..."


def reason_of(error: BaseException) -> str:
    """Reason of an error: the system's message if there is one."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def one_line(text: str) -> str:
    """``text`` with each run of white space as one blank, and `?` for characters that are not printable."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def printable(text: str) -> str:
    """``text`` with characters that a terminal would obey, such as escape sequences, as Python writes them."""
    return text if text.isprintable() else "".join(map(_printable, text))


def _printable(character: str) -> str:
    is_plain = character.isprintable() or character in "\n\t"
    return character if is_plain else repr(character)[1:-1]


def warn_once(cause: str, text: str) -> None:
    """Warn once for each cause, and not in every worker of a pool."""
    note_once(cause, f"warning: {text}")


def note_once(cause: str, text: str) -> None:
    """Print a line once for each cause, and not in every worker of a pool, unless logging is set up otherwise."""
    if cause not in _noted:
        note(text)
    _noted.add(cause)


def note(text: str) -> None:
    """Print a line, but not in the workers of a pool, unless logging is set up otherwise."""
    if parent_process() is None:
        logging.getLogger(__name__).warning("lidar-emu: %s", printable(text))

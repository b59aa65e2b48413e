"""The two errors that end a command, invalid input and a run that failed, and lines for the log."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable
from multiprocessing import parent_process

_noted = set[str]()
_MOST_LISTED = 200


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


def nearest(name: str, known: Iterable[str], cutoff: float = 0.65) -> str | None:
    """The known name that is spelled most like `name`, whatever its case; None if none is near."""
    from difflib import get_close_matches

    spelled = {each.lower(): each for each in known}
    return next((spelled[near] for near in get_close_matches(name.lower(), spelled, 1, cutoff)), None)


def did_you_mean(name: object) -> str:
    """The beginning of a remedy that suggests a name; empty if there is none to suggest."""
    return f"did you mean {name}? " if name else ""


def listed(names: Iterable[str], last: str = ", ", rest: str = "") -> str:
    """Names in one or two lines of a terminal, `last` between the last two; for a longer list, how many more there are,
    and where: ` in docs/faults.md`."""
    names = list(names)
    count = len(names)
    while count > 1 and len(", ".join(names[:count])) > _MOST_LISTED:
        count -= 1
    several = names if count == len(names) else [*names[:count], f"{len(names) - count} more{rest}"]
    return last.join((", ".join(several[:-1]), several[-1]) if several[1:] else several)


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

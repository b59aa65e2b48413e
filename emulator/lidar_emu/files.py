"""Atomic files, and the cache folder."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from secrets import token_hex
from stat import S_ISDIR, S_ISREG
from typing import BinaryIO

from lidar_emu.errors import Finding, InputError, RunError, reason_of


def check_file(path: Path, allowed: str) -> None:
    """Refuse a path that names no regular file: a pipe may never end, and a device may be read without limit.

    Args:
        path: file to read.
        allowed: what is allowed, for the error message.

    Raises:
        InputError: there is no file, or it is a folder, a pipe or a device.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise InputError(str(path), None, Finding("no such file"), allowed) from None
    except (OSError, ValueError) as error:  # a loop of links; a name that is too long, or contains NUL
        raise InputError(str(path), None, Finding(reason_of(error)), allowed) from None
    if not S_ISREG(mode):
        found = Finding("a folder" if S_ISDIR(mode) else "a pipe or a device")
        raise InputError(str(path), None, found, allowed)


def check_destination(path: Path, option: str | None = None) -> None:
    """Refuse, before a long run, a path that cannot be written.

    Raises:
        InputError: the folder is missing or not writable, or `path` cannot name a file; the error names `option` or
            `path`.
    """
    where, name = (str(path), None) if option is None else (option, str(path))
    try:
        exists, has_folder, is_folder = path.exists(), path.parent.is_dir(), path.is_dir()
    except (OSError, ValueError) as error:  # The name is too long, or contains NUL.
        raise InputError(where, None, name or Finding(str(error)), "allowed: the name of a file") from None
    if not has_folder:
        raise InputError(
            where, None, name or Finding("no such folder"), "allowed: a file in a folder that exists"
        )
    if is_folder:
        raise InputError(where, None, name or Finding("a folder"), "allowed: the name of a file")
    if not os.access(path if exists else path.parent, os.W_OK):
        raise InputError(where, None, name or Finding("not writable"), "allowed: a file that you may write")


def check_suffix(path: Path, allowed: Collection[str]) -> None:
    """Refuse a path whose suffix names no format.

    Raises:
        InputError: the suffix is not one of those allowed.
    """
    if path.suffix not in allowed:
        raise InputError(str(path), None, path.suffix or "no suffix", f"allowed: {', '.join(allowed)}")


def check_extra(where: str, what: str, module: str, extra: str) -> None:
    """Refuse what needs an optional package that is not installed.

    Args:
        where: the file or command.
        what: it needs the package.
        module: the package's name in Python.
        extra: the extra of lidar-emu that has it.

    Raises:
        InputError: `module` is not installed; names the extra that provides it.
    """
    if find_spec(module) is None:
        allowed = f"allowed after: pip install 'lidar-emu[{extra}]'"
        raise InputError(where, None, Finding(f"{what} without {module}"), allowed)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes the name `path` once it is complete; an older file stays until then.

    Any number of threads, processes and machines may write the same file concurrently; the last to finish wins.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed (for example, the disk is full).
    """
    check_destination(path)
    # A temporary file in the same folder, since a rename is atomic within one file system only.
    unfinished = path.with_name(f".{path.name}.{token_hex(4)}")
    try:
        file = unfinished.open("wb")
    except OSError as error:
        raise InputError(
            str(path), None, error.strerror or "unwritable", "allowed: a writable file"
        ) from None
    try:
        with file:
            yield file
        unfinished.replace(path)
    except OSError as error:
        raise RunError(f"{path}: could not be written: {error.strerror or error}") from error
    finally:
        unfinished.unlink(missing_ok=True)


def cache_folder() -> Path:
    """Folder of compiled kernels and generated ground, which may not exist yet.

    It is `~/.cache/lidar-emu` unless `XDG_CACHE_HOME` is set.

    Raises:
        RuntimeError: the user has no home folder.
    """
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lidar-emu"

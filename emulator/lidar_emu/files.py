"""Files that a user names, atomic files, and the cache folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from secrets import token_hex
from select import select
from stat import S_ISDIR, S_ISFIFO, S_ISREG
from typing import BinaryIO

from lidar_emu.errors import Finding, InputError, RunError, did_you_mean, nearest, reason_of

MOST_BYTES_IN_MEMORY = 4_000_000_000
"""Size beyond every honest mesh, point cloud, ESRI ASCII grid or log of a CAN bus, which are read whole."""
PIPE_PATIENCE_S = 60.0
"""A command that writes a scenario may first wait for a network or for Python to start."""


def check_file(path: Path, remedy: str, most_bytes: int | None = None) -> None:
    """Refuse a path that names no regular file, or one too large: a pipe may never end, and a device has no limit.

    Args:
        path: file to read.
        remedy: what can be done, for the error message, such as "use a YAML file".
        most_bytes: size beyond every honest file; None: the file is read piece by piece.

    Raises:
        InputError: there is no file, it is a folder, a pipe or a device, or it is larger than `most_bytes`.
    """
    try:
        state = path.stat()
    except FileNotFoundError:
        remedy = did_you_mean(near_file(path)) + remedy
        raise InputError(str(path), None, Finding("no such file"), remedy) from None
    except (OSError, ValueError) as error:  # a loop of links; a name that is too long, or contains NUL
        raise InputError(str(path), None, Finding(reason_of(error)), remedy) from None
    if not S_ISREG(state.st_mode):
        found = Finding("a folder" if S_ISDIR(state.st_mode) else "a pipe or a device")
        raise InputError(str(path), None, found, remedy)
    if most_bytes is not None and state.st_size > most_bytes:
        raise _too_large(path, state.st_size, most_bytes)


def near_file(path: Path) -> Path | None:
    """A file of the same folder whose name is spelled almost like that of a missing one; None if there is none."""
    try:
        near = nearest(path.name, (each.name for each in islice(path.parent.iterdir(), 1000)), 0.85)
    except (OSError, ValueError):
        return None
    return path.with_name(near) if near else None


def path_argument(where: str, key: str, value: object) -> Path:
    """Path that a caller of the Python interface names.

    Raises:
        InputError: it is no path, or contains NUL; the error names the function `where` and its argument `key`.
    """
    if not isinstance(value, str | os.PathLike) or "\0" in str(value):
        raise InputError(where, key, value, "must be a path")
    return Path(value)


def is_pipe(path: Path) -> bool:
    """Whether a path names a pipe, as `<(command)` and the standard input of `command | lidar-emu` do."""
    try:
        return S_ISFIFO(path.stat().st_mode)
    except (OSError, ValueError):
        return False


def read_bytes(path: Path, most_bytes: int, remedy: str) -> bytes:
    """Content of a regular file, or of a pipe until its writers close it; no more than the limit is kept.

    Args:
        path: file to read.
        most_bytes: size beyond every honest file.
        remedy: what can be done, for the error message, such as "use a YAML file".

    Raises:
        InputError: there is no such file, it cannot be read or is larger than `most_bytes`, or it is a pipe that has
            no writer or whose writers stop without closing it.
    """
    if is_pipe(path):
        return _pipe_content(path, most_bytes, remedy)
    check_file(path, remedy, most_bytes)
    try:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except OSError as error:
        raise InputError(str(path), None, Finding(reason_of(error)), remedy) from None
    if len(data) > most_bytes:  # Files of /proc state a size of 0.
        raise _too_large(path, None, most_bytes)
    return data


def _pipe_content(path: Path, most_bytes: int, remedy: str) -> bytes:
    data = bytearray()
    try:
        # Opened without waiting: to open a pipe to which nobody writes waits for ever.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise InputError(str(path), None, Finding(reason_of(error)), remedy) from None
    with open(descriptor, "rb", buffering=0) as pipe:  # noqa: PTH123
        while (piece := pipe.read(1 << 16)) != b"":
            data += piece or b""
            if len(data) > most_bytes:
                raise _too_large(path, None, most_bytes)
            # A first read comes before the first wait: a wait for a pipe that never had a writer does not end.
            if piece is None and not select([pipe], [], [], PIPE_PATIENCE_S)[0]:
                found = Finding(f"a pipe that carried nothing for {PIPE_PATIENCE_S:g} s and was not closed")
                raise InputError(str(path), None, found, remedy)
    if not data:
        raise InputError(str(path), None, Finding("a pipe to which nobody writes"), remedy)
    return bytes(data)


def _too_large(path: Path, found_bytes: int | None, most_bytes: int) -> InputError:
    found = f"more than {most_bytes} bytes" if found_bytes is None else f"{found_bytes} bytes"
    return InputError(str(path), None, Finding(found), f"the limit is {most_bytes} bytes")


def check_destination(path: Path, option: str | None = None, suffixes: Collection[str] = ()) -> None:
    """Refuse, before a long run, a path that cannot be written.

    Raises:
        InputError: the folder is missing or not writable, `path` cannot name a file, or it ends in none of `suffixes`,
            if there are any; the error names `option` or `path`.
    """

    def refusal(finding: str, remedy: str) -> InputError:
        if option is None:
            return InputError(str(path), None, Finding(finding), f"use {remedy}")
        return InputError(option, None, str(path), f"must be {remedy}")

    try:
        exists, has_folder, is_folder = path.exists(), path.parent.is_dir(), path.is_dir()
    except (OSError, ValueError) as error:  # The name is too long, or contains NUL.
        raise refusal(reason_of(error), "the name of a file") from None
    if not has_folder:
        raise refusal("no such folder", "a file in a folder that exists")
    if is_folder:
        raise refusal("a folder", "the name of a file")
    if not os.access(path if exists else path.parent, os.W_OK):
        raise refusal("not writable", "a file that you may write")
    if suffixes:
        check_suffix(path, suffixes, option)


def made_folder(option: str, name: str) -> Path:
    """Folder that an option names, made with those above it unless it exists.

    Raises:
        InputError: it cannot be made; the error names `option`.
    """
    path = Path(name)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # The name is a file's, too long, or contains NUL.
        raise InputError(option, None, name, f"must be a folder; {reason_of(error)}") from None
    return path


def check_keeps(source: Path, path: Path, option: str) -> None:
    """Refuse to write over the file that is read.

    Raises:
        InputError: `path` is the file `source`, by this name or another; the error names `option`.
    """
    try:
        is_same = path.samefile(source)
    except (OSError, ValueError):  # One of them is missing, or no name of a file.
        return
    if is_same:
        raise InputError(option, None, str(path), "must be another file than the one that is read")


def check_suffix(path: Path, known: Collection[str], option: str | None = None) -> None:
    """Refuse a path whose suffix names no format; beside an option, a device such as /dev/stdout needs none.

    Raises:
        InputError: the suffix is not a known one; the error names `option` or `path`.
    """
    if option is not None and path.suffix not in known and (path.is_file() or not path.exists()):
        raise InputError(option, None, str(path), f"must end in {' or '.join(known)}")
    if option is None and path.suffix not in known:
        found = Finding(f"unknown suffix {path.suffix}" if path.suffix else "no suffix")
        raise InputError(str(path), None, found, f"use {', '.join(known)}")


def check_extra(where: str, what: str, module: str, extra: str) -> None:
    """Refuse what needs an optional package that is not installed.

    Args:
        where: the file or command.
        what: it needs the package.
        module: the package's name in Python.
        extra: the extra of lidar-emu that has it.

    Raises:
        InputError: `module` is not installed; the remedy is the command that installs the extra, from the clone, wheel
            or repository that lidar-emu was installed from.
    """
    if find_spec(module) is None:
        raise InputError(where, None, Finding(f"{what} requires {module}"), f"run: {pip_install(extra)}")


def pip_install(extra: str) -> str:
    """Command that installs an extra, from the clone, wheel or repository that lidar-emu was installed from."""
    # Imported here: only an error needs them.
    import json
    from importlib.metadata import PackageNotFoundError, distribution
    from shlex import quote
    from shutil import which
    from urllib.parse import unquote, urlsplit

    try:
        origin = json.loads(distribution("lidar-emu").read_text("direct_url.json") or "{}")
    except PackageNotFoundError:
        origin = {}
    url = origin.get("url", "")
    if urlsplit(url).scheme == "file" and (path := Path(unquote(urlsplit(url).path))).exists():
        package = f"{path}[{extra}]"
    elif commit := origin.get("vcs_info", {}).get("commit_id"):
        package = f"lidar-emu[{extra}] @ git+{url}@{commit}"
    else:
        package = f"lidar-emu[{extra}]"
    is_editable = origin.get("dir_info", {}).get("editable", False)
    python = Path(sys.executable)
    pip = "pip" if which("pip") == str(python.with_name("pip")) else f"{quote(str(python))} -m pip"
    return f"{pip} install {'-e ' if is_editable else ''}{quote(package)}"


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
        raise InputError(str(path), None, Finding(reason_of(error)), "use a writable file") from None
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

"""Compiled kernels on disk: found again, never wrong, and compiled again where a file is not whole."""

from __future__ import annotations

import importlib
import logging
import os
import pkgutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba.core import config
from numba.core.types import float64

import lidar_emu
from lidar_emu import errors
from lidar_emu.numerics import compiler
from lidar_emu.numerics.compilation import compilation_reported_to
from lidar_emu.numerics.compiler import dispatcher
from lidar_emu.numerics.lazy_kernel import Kernel, digest

SOURCE = '''
from typing import NamedTuple
import numpy as np
from lidar_emu.numerics.kernels import kernel

OFFSET, TABLE = 2.0, np.array([1.0, 5.0])

class Line(NamedTuple):
    slope: float
    start: float

def factory(extra):
    @kernel
    def added(x):
        return x + extra
    return added

added = factory(3.0)

@kernel
def inner(line, x):
    """Add."""
    return added(line.slope * x + line.start + OFFSET + TABLE[1])

@kernel(outermost=True)
def outer(line, x):
    return inner(line, x)
'''


def made(source: str = SOURCE) -> ModuleType:
    """A module of kernels as a new process would make it."""
    module = ModuleType("lidar_emu.made")
    sys.modules[module.__name__] = module  # where a compiled kernel looks its globals up
    exec(source, vars(module))
    return module


def start(source: str = SOURCE, x: float = 10.0) -> tuple[float, int]:
    """Call the outermost kernel in a new start of the program: its result, and how often it was compiled."""
    module = made(source)
    result = module.outer(module.Line(4.0, 1.0), x)
    return result, sum(dispatcher(module.outer).stats.cache_misses.values())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(errors, "_noted", set())
    return tmp_path / "kernels"


@pytest.fixture
def warnings(caplog: pytest.LogCaptureFixture) -> Callable[[], list[str]]:
    """Returns and forgets the lines of warning."""

    def warnings() -> list[str]:
        lines = [line for line in caplog.messages if "warning" in line]
        caplog.clear()
        return lines

    return warnings


@pytest.mark.usefixtures("folder")
def test_the_log_says_once_that_kernels_are_compiled(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        start()
        start(x=10)
    assert [record.levelno for record in caplog.records] == [logging.WARNING, logging.INFO, logging.INFO]
    assert "once" in caplog.messages[0]
    assert caplog.messages[1:] == ["compiling made.outer"] * 2


@pytest.mark.usefixtures("folder")
def test_a_display_shows_kernels_instead_of_the_log(caplog: pytest.LogCaptureFixture) -> None:
    shown = list[str]()
    with compilation_reported_to(shown.append):
        start()
    assert shown == ["made.outer"]
    assert caplog.messages == []


def test_a_kernel_is_compiled_once_and_found_again(folder: Path, warnings: Callable[[], list[str]]) -> None:
    assert start() == (51.0, 1)
    assert [file.name.rpartition("-")[0] for file in folder.iterdir()] == ["made.outer"]
    assert start() == (51.0, 0)
    assert start(x=10) == (51.0, 1), "of another type"
    assert len(list(folder.iterdir())) == 2
    assert warnings() == []


@pytest.mark.usefixtures("folder")
def test_an_included_kernel_prints_and_is_no_machine_code_of_its_own(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """A text to print is an object of Python's, which included code finds in its environment."""
    source = SOURCE.replace("    return x + extra", "    print('added to', x)\n        return x + extra")
    assert [start(source), start(source)] == [(51.0, 1), (51.0, 0)]
    assert capfd.readouterr().out == 2 * "added to 48.0\n"
    module = made()
    inner = dispatcher(module.added)
    inner.compile((float64,))
    (compiled,) = inner.overloads.values()
    assert compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name) == 0


@pytest.mark.slow
def test_a_kernel_whose_named_tuple_has_moved_is_compiled_again(folder: Path) -> None:
    assert start() == (51.0, 1)
    (old,) = folder.iterdir()
    moved = made()
    moved.Line.__module__ = "lidar_emu.made_elsewhere"
    sys.modules["lidar_emu.made_elsewhere"] = moved
    assert moved.outer(moved.Line(4.0, 1.0), 10.0) == 51.0
    (new,) = set(folder.iterdir()) - {old}
    # Where a name is the same by chance, a file that names a missing class counts as none.
    del sys.modules["lidar_emu.made_elsewhere"]
    old.write_bytes(new.read_bytes())
    assert start() == (51.0, 1)


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "a byte": lambda data: data[:1],
    "half": lambda data: data[: len(data) // 2],
    "one byte short": lambda data: data[:-1],
    "longer": lambda data: data + b"\0",
    "a flipped bit": lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:],
    "garbage": lambda data: np.random.default_rng(1).bytes(len(data)),
    "zeros": lambda data: bytes(len(data)),
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_compiled_again(
    damage: str, folder: Path, warnings: Callable[[], list[str]]
) -> None:
    start()
    start(x=10)
    whole = {file: file.read_bytes() for file in folder.iterdir()}
    for file, data in whole.items():
        file.write_bytes(DAMAGES[damage](data))
    assert start() == (51.0, 1)
    assert start(x=10) == (51.0, 1)
    assert warnings() == [f"lidar-emu: warning: damaged kernels in {folder} are compiled again"], "once"
    assert start() == start(x=10) == (51.0, 0)
    assert set(folder.iterdir()) == set(whole)


def test_a_cache_that_cannot_be_written_is_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Path, warnings: Callable[[], list[str]]
) -> None:
    del folder
    (tmp_path / "file").touch()
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "file"))
    assert start() == (51.0, 1)
    assert start(x=10) == (51.0, 1)
    (line,) = warnings()
    assert "kernels are compiled at every start, since they cannot be cached: Not a directory" in line


def test_what_cannot_be_written_is_still_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch, warnings: Callable[[], list[str]]
) -> None:
    start()
    monkeypatch.setattr("os.access", lambda *_: False)  # to root every folder is writable
    assert start() == (51.0, 0)
    assert warnings() == []
    assert start(x=10) == (51.0, 1)
    (line,) = warnings()
    assert str(folder) in line
    assert line.endswith(": not writable")


@pytest.mark.parametrize("whose", ["folder", "file"])
@pytest.mark.parametrize("writable_by", [0o020, 0o002])
def test_what_others_may_write_is_not_run(
    whose: str, writable_by: int, folder: Path, warnings: Callable[[], list[str]]
) -> None:
    start()
    (file,) = folder.iterdir()
    open_to_others = folder if whose == "folder" else file
    open_to_others.chmod(open_to_others.stat().st_mode | writable_by)
    before = file.stat().st_mtime_ns
    assert start() == (51.0, 1)
    (line,) = warnings()
    assert f"kernels in {folder} are not used: another user may write there; chmod -R go-w" in line
    if whose == "folder":
        assert file.stat().st_mtime_ns == before, "nothing is kept there"
        folder.chmod(0o755)
    assert start() == (51.0, 0)


@pytest.mark.parametrize(
    ("owner", "mode", "is_trusted"),
    [
        (0, 0o644, True),
        (1000, 0o600, True),
        (1000, 0o664, False),
        (1001, 0o644, False),
        (65534, 0o600, False),
        (0, 0o666, False),
    ],
)
def test_machine_code_is_run_of_this_user_and_root_alone(
    owner: int, mode: int, is_trusted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    state = os.stat_result((mode, 1, 1, 1, owner, owner, 1, 0, 0, 0))
    assert compiler._is_trusted(state) is is_trusted


@pytest.mark.usefixtures("folder")
def test_a_generous_umask_leaves_kernels_to_their_owner() -> None:
    before = os.umask(0)
    try:
        assert start() == (51.0, 1)
    finally:
        os.umask(before)
    assert start() == (51.0, 0)


def test_a_user_without_a_home_compiles(
    folder: Path, monkeypatch: pytest.MonkeyPatch, warnings: Callable[[], list[str]]
) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert start() == (51.0, 1)
    (line,) = warnings()
    assert "Could not determine home directory" in line
    assert not folder.exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("OFFSET, TABLE = 2.0", "OFFSET, TABLE = 2.5"),
        ("[1.0, 5.0]", "[1.0, 5.5]"),
        ("line.slope * x", "line.slope / x"),
        ("factory(3.0)", "factory(3.5)"),
        ("return x + extra", "return x - extra"),
        ("slope: float\n    start: float", "start: float\n    slope: float"),
        ("class Line(NamedTuple):", "class Line(NamedTuple):\n    __module__ = 'lidar_emu.moved'"),
        ("@kernel\ndef inner", "@kernel(fastmath={'nnan'})\ndef inner"),
    ],
)
def test_a_change_of_what_a_kernel_is_compiled_from_compiles_it_again(
    old: str, new: str, folder: Path
) -> None:
    del folder
    assert SOURCE.count(old) == 1
    start()
    changed = SOURCE.replace(old, new)
    uncached = made(changed)
    expected = uncached.outer.py_func(uncached.Line(4.0, 1.0), 10.0)
    assert start(changed) == (expected, 1)
    assert start() == (51.0, 0), "both are kept"


def test_comments_docstrings_and_line_numbers_do_not_matter(folder: Path) -> None:
    del folder
    start()
    assert start("# A comment.\n\n" + SOURCE.replace("Add.", "Add more.")) == (51.0, 0)


def test_a_global_of_an_unknown_kind_is_refused() -> None:
    with pytest.raises(TypeError, match="which has no digest"):
        digest(made(SOURCE.replace("OFFSET, TABLE = 2.0", "OFFSET, TABLE = {}")).outer)


def every_kernel() -> set[Kernel]:
    names = [module.name for module in pkgutil.walk_packages(lidar_emu.__path__, "lidar_emu.")]
    modules = [importlib.import_module(name) for name in names if not name.endswith("__main__")]
    return {each for module in modules for each in vars(module).values() if isinstance(each, Kernel)}


def test_every_kernel_has_a_digest_of_its_own() -> None:
    kernels = every_kernel()
    assert len(kernels) > 200
    assert len({digest(each) for each in kernels}) == len(kernels)


PIPES: dict[str, int] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
WAITING = f"""
import sys
from lidar_emu.numerics.compiler import KernelCache

load = KernelCache.load_overload

def load_and_wait(*args):
    found = load(*args)
    print("compiles" if found is None else "found", flush=True)
    sys.stdin.readline()
    return found

KernelCache.load_overload = load_and_wait
{SOURCE}
print(outer(Line(4.0, 1.0), 10.0), flush=True)
"""


@pytest.mark.slow
def test_two_processes_compile_a_kernel_at_once(tmp_path: Path) -> None:
    """Both have looked for the kernel, in vain, before either compiles it."""
    (tmp_path / "waiting.py").write_text(WAITING)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    with ExitStack() as stack:

        def start() -> subprocess.Popen[str]:
            command = [sys.executable, "-c", "import waiting"]
            process = subprocess.Popen(command, cwd=tmp_path, env=environment, text=True, **PIPES)
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        def first_line(process: subprocess.Popen[str]) -> str:
            assert process.stdout is not None
            return process.stdout.readline()

        both = [start(), start()]
        assert [first_line(each) for each in both] == ["compiles\n"] * 2
        for each in both:
            assert each.stdin is not None
            each.stdin.write("\n")
            each.stdin.flush()
        reported = [each.communicate() for each in both]
        assert [out for out, _ in reported] == ["51.0\n"] * 2
        assert all(err.startswith("lidar-emu: compiling") and err.count("\n") == 1 for _, err in reported)
        (file,) = (tmp_path / "kernels").iterdir()
        assert file.name.startswith("waiting.outer-")
        assert start().communicate("\n") == ("found\n51.0\n", "")

"""Ctrl-C before there is a run to end: nothing is printed, and the exit code is 130."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from lidar_emu.cli import cli, main
from lidar_emu.cli.terminal import busy

CTRL_C = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
# Where Python itself ends by the signal, a shell reports 130 as well.
QUIETLY = {130, -signal.SIGINT}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("click", ["--help"]),
        ("pydantic", ["run", "bench.yaml"]),
        ("numba", ["run", "descent.yaml", "--json"]),
    ],
)
def test_while_a_module_is_imported(module: str, arguments: list[str], tmp_path: Path) -> None:
    (tmp_path / f"{module}.py").write_text(CTRL_C)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    command = [sys.executable, "-m", "lidar_emu", *arguments]
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode in QUIETLY
    assert (done.stdout, done.stderr.strip()) == ("", "")


def test_where_ctypes_swallows_it(capfd: pytest.CaptureFixture[str]) -> None:
    prepared = []

    @ctypes.CFUNCTYPE(None)
    def called_back() -> None:
        raise KeyboardInterrupt

    def prepare() -> None:
        with busy("preparing"):
            called_back()
            prepared.append("everything")

    with pytest.raises(KeyboardInterrupt):
        prepare()
    assert prepared == ["everything"]
    assert capfd.readouterr() == ("", "")


def test_what_else_goes_wrong_in_a_callback_is_reported_as_ever() -> None:
    reported: list[object] = []

    @ctypes.CFUNCTYPE(None)
    def called_back() -> None:
        raise LookupError("lost")

    before, sys.unraisablehook = sys.unraisablehook, lambda unraisable: reported.append(unraisable.exc_type)
    try:
        with busy("preparing"):
            called_back()
    finally:
        sys.unraisablehook = before
    assert reported == [LookupError]


@pytest.mark.parametrize(
    ("raised", "expected"),
    [(KeyboardInterrupt(), SystemExit(130)), (EOFError("cut"), EOFError("cut"))],
    ids=["Ctrl-C", "end of a file"],
)
def test_the_end_of_a_file_is_no_ctrl_c(
    raised: BaseException, expected: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`click` turns both into `Abort`, but no command prompts: an EOFError is a defect and keeps its traceback."""

    def callback() -> None:
        raise raised

    monkeypatch.setattr(cli.commands["scenarios"], "callback", callback)
    monkeypatch.setattr(sys, "argv", ["lidar-emu", "scenarios"])
    with pytest.raises(type(expected)) as ended:
        main()
    assert ended.value.args == expected.args


def test_ctrl_c_while_python_shuts_down_shows_nothing() -> None:
    """After the command has ended; without a last word the exit code stays the command's."""
    program = (
        "import atexit, os, signal, sys; atexit.register(os.kill, os.getpid(), signal.SIGINT); "
        "sys.argv[1:] = ['--version']; from lidar_emu.__main__ import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")

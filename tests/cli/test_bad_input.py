"""Unusable input is rejected in one line that states where, which key, which value and what is allowed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bad_commands
import bad_files
import bad_scenarios
import pytest
from bad_case import BENCH, FLIGHT, Case, Content
from waiting import LIMIT_S

from lidar_emu import cli
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model

CASES = [*bad_scenarios.CASES, *bad_files.CASES, *bad_commands.CASES]
JARGON = (
    "the value",
    "should be",
    "valid string",
    "valid dictionary",
    "found using",
    "pydantic",
    "Traceback",
)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def check_line(case: Case, text: str) -> None:
    assert text.startswith("lidar-emu: ")
    assert text.endswith("\n")
    assert text.count("\n") == 1
    for part in case.expected:
        assert part in text
    for word in JARGON:
        assert word not in text


def test_names_are_unique() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_refused_in_one_line(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    case.write_files(tmp_path)
    before = contents(tmp_path)
    monkeypatch.setattr(sys, "argv", ["lidar-emu", *case.command.split()])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    printed = capfd.readouterr()
    assert ended.value.code == 2, printed
    assert printed.out == ""
    check_line(case, printed.err)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("name", ["unknown key below", "three misalignments", "no such port"])
def test_refused_as_a_program(name: str, tmp_path: Path) -> None:
    (case,) = (case for case in CASES if case.name == name)
    case.write_files(tmp_path)
    before = contents(tmp_path)
    program = [sys.executable, "-c", "from lidar_emu.cli import main; main()", *case.command.split()]
    ended = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stdout == ""
    check_line(case, ended.stderr)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("text", [FLIGHT, BENCH, bad_files.on_grid("dem.npz"), bad_files.on_table()])
def test_unbroken_files_are_good(text: str, tmp_path: Path) -> None:
    files: dict[str, Content] = {"my.yaml": text, "dem.npz": bad_files.LEVEL, "flight.csv": bad_files.ROWS}
    Case("unbroken", (), files).write_files(tmp_path)
    assert build_model(load(tmp_path / "my.yaml")).shot_count > 0


def test_an_older_recording_outlives_a_refused_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    older = tmp_path / "out.mcap"
    older.write_bytes(b"precious")
    monkeypatch.setattr(
        sys, "argv", ["lidar-emu", "run", "bench", "--port", "/dev/nowhere", "--record", older.name]
    )
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert older.read_bytes() == b"precious"


def test_without_a_command_the_help_is_an_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["lidar-emu"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    printed = capsys.readouterr()
    assert ended.value.code == 2
    assert printed.out == ""
    assert printed.err.startswith("Usage: lidar-emu [")
    assert printed.err.count("\n") > 10


def test_warnings_of_numpy_stay_silent_unless_asked_for() -> None:
    program = "import lidar_emu.__main__, numpy; numpy.float64(1e300) * numpy.full(1, 1e300); numpy.mean([])"

    def run(*flags: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *flags, "-c", program], check=False, capture_output=True, text=True
        )

    assert run().stderr == ""
    assert "RuntimeWarning: overflow" in run("-W", "error").stderr


@pytest.mark.parametrize(
    "command", ["run descent.yaml --pace max", "plan descent.yaml", "ground descent.yaml"]
)
def test_too_little_memory_is_one_line_instead_of_a_start_without_end(command: str) -> None:
    limited = f"ulimit -v 400000; exec {sys.executable} -m lidar_emu {command}"
    ran = subprocess.run(
        ["bash", "-c", limited], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert ran.returncode == 1
    assert ran.stderr.startswith("lidar-emu: too little memory: this process may have 400000 kB; allow ")
    assert ran.stderr.count("\n") == 1

"""Too few open files, files of limited size, and a recording that is deleted: one line, and nothing lost unsaid."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.errors import RunError
from lidar_emu.recording.write import Recorder

RUN = "run bench.yaml --duration 1 --pace max --plain"


def limited(limit: str, command: str) -> subprocess.CompletedProcess[str]:
    program = f"ulimit {limit}; exec {sys.executable} -m lidar_emu {command}"
    return subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_too_few_descriptors_are_one_line() -> None:
    ended = limited("-n 16", RUN)
    assert ended.returncode == 1
    assert ended.stderr == "lidar-emu: too many open files; allow 64 or more (ulimit -n)\n"


def test_standard_output_is_silenced_without_a_further_descriptor() -> None:
    program = """
import os
from resource import RLIMIT_NOFILE, setrlimit
from lidar_emu.cli.terminal import silence
setrlimit(RLIMIT_NOFILE, (3, 3))
print("heard", flush=True)
silence()
print("lost", flush=True)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "heard\n", "")


@pytest.mark.slow
def test_a_limit_of_file_size_below_the_shared_memory_is_one_line() -> None:
    ended = limited("-f 1", RUN)
    assert ended.returncode == 1
    assert ended.stderr.startswith("lidar-emu: memory of ")
    assert ended.stderr.count("\n") == 1


@pytest.mark.slow
def test_a_recording_beyond_the_limit_of_file_size_does_not_end_the_flight(tmp_path: Path) -> None:
    """4 MB hold the shared memory and not the recording of 20 000 shots."""
    record = tmp_path / "flight.mcap"
    ended = limited("-f 4000", f"{RUN} --duration 200 --set timing.rate_hz=100 --record {record}")
    assert ended.returncode == 1
    assert ended.stderr == f"lidar-emu: {record}: the recording is incomplete: File too large\n"
    assert "20000 sent, 0 late" in ended.stdout


def test_a_text_beyond_the_limit_of_file_size_leaves_the_older_file_or_none(tmp_path: Path) -> None:
    older = tmp_path / "INTERFACE.md"
    older.write_text("older")
    ended = limited("-f 1", f"icd --out {tmp_path}")
    assert (ended.returncode, ended.stderr) == (
        1,
        f"lidar-emu: {older}: could not be written: File too large\n",
    )
    new = tmp_path / "new.yaml"
    ended = limited("-f 1", f"new {new}")
    assert (ended.returncode, ended.stderr) == (
        1,
        f"lidar-emu: {new}: could not be written: File too large\n",
    )
    assert older.read_text() == "older"
    assert list(tmp_path.iterdir()) == [older]


def test_a_recording_deleted_in_flight_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = tmp_path / "flight.mcap"
    on_block_sent = Recorder.on_block_sent

    def delete_first(recorder: Recorder, block: Any) -> None:
        record.unlink(missing_ok=True)
        on_block_sent(recorder, block)

    monkeypatch.setattr(Recorder, "on_block_sent", delete_first)
    ended = CliRunner().invoke(cli, [*RUN.split(), "--record", str(record)])
    assert isinstance(ended.exception, RunError)
    assert str(ended.exception) == f"{record}: the recording was deleted during the run"
    assert "10 sent" in ended.stdout

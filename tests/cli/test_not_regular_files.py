"""Paths that name no regular file, or one without end: refused in one line; and pipes where a scenario is read."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest
from click.testing import CliRunner

import lidar_emu
from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.files import MOST_BYTES_IN_MEMORY, check_file, read_bytes
from lidar_emu.scenario.load import load

TABLE = "time: {column: t, unit: s}, north: {column: n, unit: m}, up: {column: u, unit: m}"
COMMANDS = {
    "trajectory": ["plan", "descent.yaml", "--set", f"trajectory={{kind: table, file: FILE, {TABLE}}}"],
    "grid": ["plan", "descent.yaml", "--set", "site.ground={kind: grid, file: FILE}"],
    "mesh": ["plan", "descent.yaml", "--set", "site.ground={kind: mesh, file: FILE, unit: m}"],
    "interface": ["plan", "descent.yaml", "--set", "wire.interface=FILE"],
    "recording": ["report", "FILE"],
    "traffic": ["replay", "FILE", "--to", "out.pcap"],
    "scenario of a campaign": ["campaign", "campaign.yaml", "--out", "results"],
    "part": ["plan", "descent.yaml", "--set", "instrument=FILE"],
    "geometry": ["simulate", "descent.yaml", "--geometry", "FILE", "--out", "out.csv"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_pipe_is_not_read(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To open a pipe to which nobody writes waits for ever."""
    monkeypatch.chdir(tmp_path)
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    campaign = tmp_path / "campaign.yaml"
    campaign.write_text(f"name: piped\nscenario: {pipe}\nruns: 2\n")
    result = CliRunner().invoke(cli, [word.replace("FILE", str(pipe)) for word in COMMANDS[command]])
    assert isinstance(result.exception, InputError)
    found = "no such file: " if command == "part" else f"{pipe}: a pipe or a device; "
    assert found in str(result.exception)
    assert set(tmp_path.iterdir()) == {pipe, campaign}


def test_what_a_path_names_instead(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    cases = {
        "/dev/zero": "a pipe or a device",
        str(tmp_path): "a folder",
        str(tmp_path / "none"): "no such file",
        str(tmp_path / "a"): "Too many levels of symbolic links",
        "a\0b": "null",
        300 * "x": "File name too long",
    }
    for path, found in cases.items():
        with pytest.raises(InputError, match=found):
            check_file(Path(path), "must be a file")
    check_file(Path(__file__), "must be a file")


@contextmanager
def piped(data: bytes, closed: bool = True) -> Iterator[str]:
    """Path of a pipe that carries `data`, as `<(command)` passes it; a thread writes, since a pipe holds 64 kB."""
    reading, writing = os.pipe()

    def write() -> None:
        try:
            os.write(writing, data)
        except BrokenPipeError:
            pass
        finally:
            if closed:
                os.close(writing)

    writer = Thread(target=write)
    writer.start()
    try:
        yield f"/dev/fd/{reading}"
    finally:
        os.close(reading)
        writer.join()
        if not closed:
            os.close(writing)


@pytest.fixture(name="descent")
def _descent() -> bytes:
    return (Path(lidar_emu.__file__).parent / "shipped/scenarios/descent.yaml").read_bytes()


def test_a_scenario_may_come_from_a_pipe(descent: bytes) -> None:
    with piped(descent) as pipe:
        assert load(pipe) == load("descent")


def test_files_of_a_piped_scenario_are_in_the_working_folder(
    descent: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text("base: mare\n")
    with piped(descent.replace(b"site: mare", b"site: mine.yaml")) as pipe:
        assert load(pipe) == load("descent")


def test_a_hyphen_is_the_standard_input(descent: bytes) -> None:
    program = [sys.executable, "-m", "lidar_emu", "plan", "-", "--duration", "1"]
    ran = subprocess.run(program, input=descent, capture_output=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("data", "closed", "found"),
    [
        (b"", True, "a pipe to which nobody writes"),
        (bytes(3_000_000), True, "more than 1000000 bytes; the limit is 1000000"),
        (b"name: x", False, "carried nothing for 0.01 s and was not closed"),
    ],
)
def test_a_pipe_without_a_scenario(
    data: bytes, closed: bool, found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not closed:
        monkeypatch.setattr("lidar_emu.files.PIPE_PATIENCE_S", 0.01)
    with piped(data, closed) as pipe, pytest.raises(InputError, match=found):
        load(pipe)


def test_a_named_pipe_without_a_writer_is_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="a pipe to which nobody writes"):
        load(pipe)


SIZES = {
    "scenario.yaml": (1_000_000, ["plan", "FILE"]),
    "interface.toml": (1_000_000, ["plan", "descent.yaml", "--set", "wire.interface=FILE"]),
    "trajectory.csv": (1_000_000_000, COMMANDS["trajectory"]),
    "mesh.obj": (MOST_BYTES_IN_MEMORY, COMMANDS["mesh"]),
    "bus.log": (MOST_BYTES_IN_MEMORY, COMMANDS["traffic"]),
    "points.xyz": (
        MOST_BYTES_IN_MEMORY,
        ["plan", "descent.yaml", "--set", "site.ground={kind: grid, file: FILE, pixel_m: 1}"],
    ),
}


@pytest.mark.parametrize("name", SIZES)
def test_a_file_too_large_is_refused_unread(name: str, tmp_path: Path) -> None:
    """Sparse files: they state terabytes and occupy none."""
    most_bytes, command = SIZES[name]
    path = tmp_path / name
    path.touch()
    os.truncate(path, 2**42)
    result = CliRunner().invoke(cli, [word.replace("FILE", str(path)) for word in command])
    assert isinstance(result.exception, InputError)
    assert f"{path}: " in str(result.exception)
    assert f"{most_bytes} bytes" in str(result.exception)


def test_a_file_that_states_no_size_is_bounded_too() -> None:
    path = Path("/proc/self/maps")
    assert path.stat().st_size == 0
    with pytest.raises(InputError, match="more than 10 bytes; the limit is 10"):
        read_bytes(path, 10, "must be a file")

"""Paths that name no regular file: refused in one line, where reading a pipe or a device would never end."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.files import check_file

TABLE = "time: {column: t, unit: s}, north: {column: n, unit: m}, up: {column: u, unit: m}"
COMMANDS = {
    "scenario": ["plan", "FILE"],
    "trajectory": ["plan", "descent.yaml", "--set", f"trajectory={{kind: table, file: FILE, {TABLE}}}"],
    "grid": ["plan", "descent.yaml", "--set", "site.ground={kind: grid, file: FILE}"],
    "mesh": ["plan", "descent.yaml", "--set", "site.ground={kind: mesh, file: FILE, unit: m}"],
    "interface": ["plan", "descent.yaml", "--set", "wire.interface=FILE"],
    "recording": ["report", "FILE"],
    "traffic": ["replay", "FILE", "--to", "out.pcap"],
    "geometry": ["simulate", "descent.yaml", "--geometry", "FILE", "--out", "out.csv"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_pipe_is_not_read(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To open a pipe to which nobody writes waits for ever."""
    monkeypatch.chdir(tmp_path)
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    result = CliRunner().invoke(cli, [word.replace("FILE", str(pipe)) for word in COMMANDS[command]])
    assert isinstance(result.exception, InputError)
    assert f"{pipe}: a pipe or a device; allowed: " in str(result.exception)
    assert list(tmp_path.iterdir()) == [pipe]


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
            check_file(Path(path), "allowed: a file")
    check_file(Path(__file__), "allowed: a file")

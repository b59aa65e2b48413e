"""What an error prints for a missing extra installs it from where lidar-emu came from."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest

from lidar_emu.errors import InputError
from lidar_emu.files import check_extra


@pytest.fixture
def printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The command printed where a distribution has this record of its origin, as pip writes it."""

    def with_origin(origin: dict[str, Any] | None) -> str:
        metadata = tmp_path / "lidar_emu-0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: lidar-emu\nVersion: 0\n")
        if origin is not None:
            (metadata / "direct_url.json").write_text(json.dumps(origin))
        monkeypatch.syspath_prepend(tmp_path)
        with pytest.raises(InputError) as refused:
            check_extra("flight.html", "a figure", "a_module_that_nobody_has", "plots")
        return str(refused.value.remedy)

    return with_origin


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A clone whose name a shell would split and expand."""
    clone = tmp_path / "Ann's $clone"
    clone.mkdir()
    return clone


def test_a_clone(printed: Any, folder: Path) -> None:
    command = shlex.split(printed({"url": folder.as_uri(), "dir_info": {}}))
    assert command[-2:] == ["install", f"{folder}[plots]"]


def test_an_editable_clone_stays_editable(printed: Any, folder: Path) -> None:
    command = shlex.split(printed({"url": folder.as_uri(), "dir_info": {"editable": True}}))
    assert command[-3:] == ["install", "-e", f"{folder}[plots]"]


def test_a_commit_of_a_repository(printed: Any) -> None:
    url = "https://example.org/lidar-emu.git"
    command = shlex.split(printed({"url": url, "vcs_info": {"vcs": "git", "commit_id": "abc"}}))
    assert command[-1] == f"lidar-emu[plots] @ git+{url}@abc"


@pytest.mark.parametrize("origin", [None, {"url": "file:///gone/lidar_emu-0.whl", "archive_info": {}}])
def test_an_index_or_a_wheel_that_is_gone(printed: Any, origin: Any) -> None:
    assert printed(origin).endswith("pip install 'lidar-emu[plots]'")


def test_pip_is_that_of_this_environment(printed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/opt/an environment/bin/python")
    assert printed(None).startswith("run: '/opt/an environment/bin/python' -m pip install ")

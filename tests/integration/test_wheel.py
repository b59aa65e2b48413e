"""What is installed is whole: a wheel in an environment of its own, and the tree from an empty folder."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path

import pytest
from wheels import TREE, built_wheel, done, install

PACKAGES = {"lidar_emu": "emulator", "lidar_protocol": "protocol", "lidar_icd": "protocol"}


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    """A folder with nothing in it."""
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture
def installed(wheel: Path, tmp_path: Path) -> Path:
    """Scripts of a new environment with the wheel in it."""
    return install(wheel, tmp_path / "environment")


@pytest.mark.slow
def test_the_wheel_holds_every_file_of_the_packages(wheel: Path) -> None:
    in_tree = {
        str(path.relative_to(TREE / root))
        for package, root in PACKAGES.items()
        for path in (TREE / root / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if ".dist-info/" not in name}
    beside = {
        str(Path("lidar_emu") / path.relative_to(TREE))
        for folder in ("docs", "examples")
        for path in (TREE / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert packed == in_tree | beside
    assert {
        "lidar_protocol/lidar.dbc",
        "lidar_protocol/INTERFACE.md",
        "lidar_icd/c/header_template.h",
    } <= packed
    assert "lidar_emu/shipped/ground/mare.npz" in packed


@pytest.mark.slow
def test_a_wheel_flies_from_an_empty_folder(installed: Path, empty: Path) -> None:
    where = done(installed / "python", "-c", "import lidar_emu; print(lidar_emu.__file__)", folder=empty)
    assert Path(where.strip()).is_relative_to(installed.parent)
    assert "descent.yaml" in done(installed / "lidar-emu", "scenarios", folder=empty)
    overview = done(installed / "lidar-emu", "--help", folder=empty)
    (folder,) = re.findall(r"Files named docs/\.\.\. and examples/\.\.\. are in\s+(\S+)\n", overview)
    for command in ("campaign", "bench accuracy", "bench realtime"):
        shown = done(installed / "lidar-emu", *command.split(), "--help", folder=empty)
        for page in re.findall(r"docs/[\w/-]+\.md", shown):
            assert (Path(folder) / page).is_file()
    run = done(installed / "lidar-emu", "run", "descent.yaml", "--pace", "max", "--json", folder=empty)
    reported = json.loads(run.splitlines()[-1])
    assert reported["shots"]["sent"] == reported["planned_shots"] == 1008
    assert reported["far_end"]["messages"] == 1008 + reported["housekeeping"]["sent"]
    assert list(empty.iterdir()) == []


@pytest.mark.slow
def test_a_wheel_brings_the_fixture_of_the_tests(installed: Path, empty: Path) -> None:
    fixtures = done(
        installed / "python", "-m", "pytest", "--fixtures", "-p", "no:cacheprovider", folder=empty
    )
    assert "lidar_emulator -- " in fixtures

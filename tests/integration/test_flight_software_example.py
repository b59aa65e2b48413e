"""The flight-software repository of the examples: its README's command builds it and passes its tests."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
from installed_programs import with_programs

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "flight_software_ci"
INSTALL = "pip install './lidar-emu[test]'"


def commands() -> list[str]:
    return re.findall(r"^    (.+)$", (EXAMPLE / "README.md").read_text(), re.MULTILINE)


def entry_points() -> dict[str, str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "test" in project["optional-dependencies"]
    plugins: dict[str, str] = project["entry-points"]["pytest11"]
    return plugins


def test_its_workflow_runs_what_its_readme_prints() -> None:
    workflow = (EXAMPLE / ".github" / "workflows" / "test.yml").read_text()
    assert re.findall(r"- run: (.+)$", workflow, re.MULTILINE) == commands()


def test_the_plugin_is_an_entry_point_of_the_package() -> None:
    ((name, module),) = entry_points().items()
    assert name == module, "loaded by `pytest -p` under the same name, it is loaded once"
    assert hasattr(import_module(module), "lidar_emulator")


@pytest.mark.slow
def test_it_passes_as_printed(tmp_path: Path) -> None:
    install, *printed = commands()
    assert install == INSTALL, "done already: this environment has the package and its extra"
    if shutil.which("cc") is None or shutil.which("make") is None:
        pytest.skip("there is no C compiler, or no make, on this machine")
    shutil.copytree(EXAMPLE, tmp_path / "repository", ignore=shutil.ignore_patterns("build"))
    # In a tree that is not installed, the entry point is stated here.
    environment = with_programs(PYTEST_PLUGINS=",".join(entry_points()))
    for command in printed:
        done = subprocess.run(
            command, shell=True, cwd=tmp_path / "repository", env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout
    assert "skipped" not in done.stdout

"""Wheels of the tree, and environments in which they are installed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

from waiting import LIMIT_S

CAN_BUILD = bool(
    shutil.which("cc") and shutil.which("c++") and (Path(sysconfig.get_path("include")) / "Python.h").exists()
)
"""Whether machine code of kernels can be built here."""
TREE = Path(__file__).resolve().parents[2]


def done(*command: str | Path, folder: Path, limit_s: float = LIMIT_S, **environment: str) -> str:
    """The output of a command that must succeed."""
    result = subprocess.run(
        list(map(str, command)),
        env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | environment,
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=limit_s,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def built_wheel(folder: Path, **environment: str) -> Path:
    """Build a wheel in a folder."""
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, TREE]
    done(*command, folder=folder, **environment)
    (built,) = folder.glob("lidar_emu-*.whl")
    return built


def install(wheel: Path, environment: Path, *, without: Sequence[str] = ()) -> Path:
    """Scripts of a new environment with a wheel in it, and with what is installed here, but not the tree.

    Args:
        wheel: the wheel; its dependencies must be there.
        environment: folder of the environment.
        without: packages and folders of libraries that the environment lacks.
    """
    folder = environment.parent
    done(sys.executable, "-m", "venv", "--without-pip", environment, folder=folder)
    python = environment / "bin" / "python"
    libraries = done(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", folder=folder)
    dependencies = environment / "dependencies"
    dependencies.mkdir()
    hidden = re.compile(rf"_?({'|'.join(['lidar_emu', *without])})\b")
    for here in {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}:
        for path in Path(here).iterdir():
            if not hidden.match(path.name):
                (dependencies / path.name).symlink_to(path)
    # Of a folder in a .pth file, the .pth files are not read.
    (Path(libraries.strip()) / "dependencies.pth").write_text(f"{dependencies}\n")
    pip: list[str | Path] = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python]
    done(*pip, "install", "--quiet", "--no-index", wheel, folder=folder)
    return environment / "bin"

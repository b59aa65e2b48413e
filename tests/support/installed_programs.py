"""Programs that are installed beside this Python, found as in an activated environment."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_SCRIPTS = Path(sys.executable).parent
LIDAR_EMU = str(_SCRIPTS / "lidar-emu")
CANTOOLS = str(_SCRIPTS / "cantools")


def with_programs(**variables: str) -> dict[str, str]:
    """Environment variables with these programs first on the path, and further variables."""
    return {**os.environ, "PATH": f"{_SCRIPTS}{os.pathsep}{os.environ['PATH']}", **variables}

"""Puts the machine code of kernels into a wheel, if `make wheel` has built some."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelsHook(BuildHookInterface[Any]):
    """Adds the files in the folder LIDAR_EMU_KERNELS; such a wheel is for one version of Python and one platform."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """See hatchling."""
        del version
        folder = os.environ.get("LIDAR_EMU_KERNELS")
        if folder:
            for path in Path(folder).iterdir():
                build_data["force_include"][str(path)] = f"lidar_emu/numerics/{path.name}"
            build_data |= {"pure_python": False, "infer_tag": True}

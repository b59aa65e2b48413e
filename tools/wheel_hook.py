"""Puts the machine code of kernels into a wheel, if `make wheel` has built some, and omits the compiler then."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

KERNELS = os.environ.get("LIDAR_EMU_KERNELS")
"""Folder with machine code; not set: none was built."""


class DependenciesHook(MetadataHookInterface):
    """States the dependencies, with those of the extra `compiler` unless machine code is in the wheel."""

    def update(self, metadata: dict[str, Any]) -> None:
        """See hatchling."""
        compiler = [] if KERNELS else metadata["optional-dependencies"]["compiler"]
        metadata["dependencies"] = [*self.config["dependencies"], *compiler]


class KernelsHook(BuildHookInterface[Any]):
    """Adds the files in the folder of machine code; such a wheel is for one version of Python and one platform."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """See hatchling."""
        del version
        if KERNELS:
            for path in Path(KERNELS).iterdir():
                build_data["force_include"][str(path)] = f"lidar_emu/numerics/{path.name}"
            build_data |= {"pure_python": False, "infer_tag": True}

"""A hardware-in-the-loop emulator of a multi-beam FMCW Doppler landing lidar.

import lidar_emu

run = lidar_emu.simulate(lidar_emu.load("descent.yaml"), seed=1)
run.range_m            # (shots, beams), NaN where a beam has no valid range
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lidar_emu.scenario.load import load as load
    from lidar_emu.shots.model import simulate as simulate

__version__ = "0.1.0"
__all__ = ["__version__", "load", "simulate"]

_HOMES = {"load": "lidar_emu.scenario.load", "simulate": "lidar_emu.shots.model"}


def __getattr__(name: str) -> Any:
    """Import attributes on first use: the model takes a second to load, which `--help` must not."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)

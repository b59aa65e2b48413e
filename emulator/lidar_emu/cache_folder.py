"""Where the tool keeps what it would otherwise make again: compiled kernels and generated ground."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """`~/.cache/lidar-emu` unless `XDG_CACHE_HOME` says otherwise; perhaps not made yet.

    Raises:
        RuntimeError: for a user without a home.
    """
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lidar-emu"

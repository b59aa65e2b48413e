"""numba's compiler, with a cache of compiled kernels that follows the sources.

numba keeps a compiled function until the file of that very function changes, whatever changes in what it calls.
So the cache lies in a folder named after all files that hold kernels: `~/.cache/lidar-emu/` unless
`XDG_CACHE_HOME` or `NUMBA_CACHE_DIR` say otherwise.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from numba import njit
from numba.core import config

__all__ = ["njit"]

_ROOMS = ("fmcw", "scene")


def _sources_digest() -> str:
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(path for room in _ROOMS for path in (package / room).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "lidar-emu" / f"kernels-{_sources_digest()}"


if not config.CACHE_DIR:  # type: ignore[attr-defined]
    config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]

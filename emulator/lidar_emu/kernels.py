"""numba's compiler, with a cache of compiled kernels that follows the sources.

numba keeps a compiled function until the file of that very function changes, whatever changes in what it calls.
So the cache lies in a folder named after all files that hold kernels: `~/.cache/lidar-emu/` unless
`XDG_CACHE_HOME` or `NUMBA_CACHE_DIR` say otherwise.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import config
from numba.extending import intrinsic

__all__ = ["njit", "unowned"]

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


@intrinsic
def _unowned(_typing_context: Any, array: Any) -> Any:
    """The same array without an owner, for kernels that hand arrays on while their caller holds them.

    numba counts references to an array's owner wherever the array is handed on, and does so atomically: in code made of
    short kernels that is half of the time.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(signature.return_type)(context, builder, value=arguments[0])
        view.meminfo = view.meminfo.type(None)
        view.parent = view.parent.type(None)
        return view._getvalue()

    return array(array), generate


# To the type checker an intrinsic still has the compiler's own first argument.
unowned: Any = _unowned

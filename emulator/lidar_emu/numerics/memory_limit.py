"""The least address space that numba and the linear algebra libraries of numpy and scipy start in."""

from __future__ import annotations

import os

from lidar_emu.errors import RunError

_LEAST_BYTES = 500 << 20
_EACH_PROCESSOR_BYTES = 50 << 20
"""OpenBLAS reserves memory for a thread on each processor, twice: numpy and scipy have one each."""


def check_memory_limit() -> None:
    """Check the limit on address space before a library is loaded: OpenBLAS tries for ever to start in less.

    Raises:
        RunError: the limit is too low.
    """
    try:
        from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit
    except ImportError:  # a system without such limits
        return
    limit_bytes = getrlimit(RLIMIT_AS)[0]
    least_bytes = _LEAST_BYTES + _EACH_PROCESSOR_BYTES * (os.cpu_count() or 1)
    if limit_bytes != RLIM_INFINITY and limit_bytes < least_bytes:
        raise RunError(
            f"too little memory: this process may have {limit_bytes >> 10} kB; "
            f"allow {least_bytes >> 10} kB (ulimit -v)"
        )

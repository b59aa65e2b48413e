"""Shape models in SPICE kernels (DSK, type 2: triangular plates), read by spiceypy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_extra
from lidar_emu.scene.mesh.indexed import IndexedMesh

_PLATES = 2
_AT_ONCE = 1_000_000
_INTACT = "use a DSK with segments of type 2, plates"


def read_dsk(path: Path) -> IndexedMesh:
    """Read the plates of all segments, in kilometres."""
    check_extra(str(path), "a DSK", "spiceypy", "spice")
    import spiceypy

    try:
        handle = spiceypy.dasopr(str(path))
        try:
            return _joined(path, spiceypy, handle)
        finally:
            spiceypy.dascls(handle)
    except spiceypy.utils.exceptions.SpiceyError as error:
        found = Finding(f"unreadable, {getattr(error, 'short', '') or 'damaged'}")
        raise InputError(str(path), None, found, _INTACT) from None


def _joined(path: Path, spiceypy: Any, handle: int) -> IndexedMesh:
    vertex, face, count = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0
    try:
        segment = spiceypy.dlabfs(handle)
        while True:
            if spiceypy.dskgd(handle, segment).dtype != _PLATES:
                raise InputError(str(path), None, Finding("a segment of another type"), _INTACT)
            vertices, plates = spiceypy.dskz02(handle, segment)
            vertex += [
                spiceypy.dskv02(handle, segment, first, min(_AT_ONCE, vertices - first + 1))
                for first in range(1, vertices + 1, _AT_ONCE)
            ]
            face += [
                spiceypy.dskp02(handle, segment, first, min(_AT_ONCE, plates - first + 1)) - 1 + count
                for first in range(1, plates + 1, _AT_ONCE)
            ]
            count += vertices
            segment = spiceypy.dlafns(handle, segment)
    except spiceypy.utils.exceptions.NotFoundError:  # No further segment.
        return IndexedMesh(np.concatenate(vertex), np.concatenate(face))

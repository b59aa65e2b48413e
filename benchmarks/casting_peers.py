"""Third-party ray tracers, if installed: triangles in, ranges and normals out.

Both compute in float32. A peer's rays are converted beforehand, which is not timed, and all are traced in one call.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.casting_comparison import Embree


class Tracer(Protocol):
    """A scene of triangles, built and warm."""

    def prepare(self, origin: FloatArray, direction: FloatArray) -> Callable[[], Any]:
        """A call that traces n rays, arrays (n, 3): distance, normal and triangle of each."""

    def range_m(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """(n,) Distances; NaN where nothing is hit."""


class Open3D:
    """Open3D's RaycastingScene: Embree by ray streams."""

    def __init__(self, vertex_m: FloatArray, face: NDArray[np.int64]) -> None:
        open3d: Any = import_module("open3d")
        self._tensor = open3d.core.Tensor
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        mesh = vertex_m.astype(np.float32), face.astype(np.uint32)
        self._scene.add_triangles(*(self._tensor(each) for each in mesh))
        self.range_m(vertex_m[:1], np.array([[0.0, 0.0, -1.0]]))

    def prepare(self, origin: FloatArray, direction: FloatArray) -> Callable[[], Any]:
        """See `Tracer`."""
        rays = self._tensor(np.hstack([origin, direction]).astype(np.float32))
        return lambda: self._scene.cast_rays(rays, nthreads=1)

    def range_m(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """See `Tracer`."""
        t = self.prepare(origin, direction)()["t_hit"].numpy().astype(np.float64)
        return np.where(np.isfinite(t), t, np.nan)


Build = Callable[[FloatArray, NDArray[np.int64]], Tracer]

_PEERS: dict[str, Build] = {"embreex": Embree, "open3d": Open3D}


def installed_peers() -> tuple[dict[str, Build], dict[str, str]]:
    """The peers that can be imported, and the reasons why others cannot."""
    found, absent = {}, {}
    for name, build in _PEERS.items():
        try:
            if find_spec(name) is None:
                raise ImportError("not installed")
            import_module(name)
        except (ImportError, OSError) as error:  # open3d needs libraries that a bare system lacks
            absent[name] = str(error).splitlines()[0]
        else:
            found[name] = build
    return found, absent

"""The timeline that all entities of the viewer share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    import rerun as rr

TIMELINE = "scenario_time"


def send(stream: rr.RecordingStream, entity: str, time_s: FloatArray | Sequence[float], columns: Any) -> None:
    """Send values of an entity at instants of scenario time.

    Args:
        stream: a file or a viewer.
        entity: path of the entity.
        time_s: (n,) scenario times.
        columns: n values of each component.
    """
    import rerun as rr

    if len(time_s):
        stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=np.asarray(time_s))], columns)


def seconds(time_ns: IntArray) -> FloatArray:
    """Scenario times in seconds."""
    return np.asarray(time_ns, dtype=np.float64) * 1e-9

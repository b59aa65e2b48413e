"""Of two things that a ray might hit, the one that it hits."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import IntArray
from lidar_emu.scene.hits import Hits


def keep_nearer(hits: Hits, others: Hits, rows: IntArray | None = None) -> None:
    """Put hits of other things into `hits` where these come first, or at the same place.

    What a ray starts inside of comes before all that it hits.

    Args:
        hits: (n,) changed.
        others: (m,) of the same rays, on something else.
        rows: (m,) which of the n rays they are; None: all.
    """
    rows = np.arange(len(others.range_m)) if rows is None else rows
    range_m = hits.range_m[rows]
    nearer = (others.range_m <= range_m) | (np.isnan(range_m) & np.isfinite(others.range_m))
    nearer = others.inside | (nearer & ~hits.inside[rows])
    if nearer.any():
        hits.set_rows(rows[nearer], others.chosen(nearer))

"""Arrangement of the views: the flight beside plots and events."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.viewer.timeline import TIMELINE

if TYPE_CHECKING:
    import rerun.blueprint as rrb

    from lidar_emu.report.ground_below import Extent

PLOTS = {
    "range_m": "Range (m)",
    "closing_speed_mps": "Closing speed (m/s)",
    "range_error_m": "Range error (m)",
    "closing_speed_error_mps": "Closing speed error (m/s)",
    "lateness_us": "Lateness (us)",
}
_FROM_CENTRE = np.array([-0.55, -0.9, 0.25])
_POINTS_S = 10.0
"""Points of these last seconds are shown."""


def layout(extent: Extent | None, keeps_time: bool) -> rrb.Blueprint:
    """Arrange the views of a recording.

    Args:
        extent: the box to look at; None: there is no flight to show in three dimensions.
        keeps_time: packets had deadlines, so that there is a lateness.
    """
    import rerun.blueprint as rrb
    from rerun.encodings import TimeRange, TimeRangeBoundary

    names = [name for name in PLOTS if keeps_time or name != "lateness_us"]
    legend = rrb.PlotLegend(corner="RightTop")
    plots = rrb.Vertical(
        *(rrb.TimeSeriesView(origin=f"/{name}", name=PLOTS[name], plot_legend=legend) for name in names)
    )
    events = rrb.TextLogView(origin="/events", name="Events")
    panel = rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="playing")
    if extent is None:
        return rrb.Blueprint(rrb.Horizontal(plots, events), panel, collapse_panels=True)
    last = TimeRange(
        start=TimeRangeBoundary.cursor_relative(seconds=-_POINTS_S),
        end=TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    flight = rrb.Spatial3DView(
        origin="/site",
        name="Flight",
        eye_controls=_eye(extent),
        overrides={"site/points": rrb.VisibleTimeRanges(rrb.VisibleTimeRange(TIMELINE, last))},
    )
    left = rrb.Vertical(flight, events, row_shares=[4, 1])
    return rrb.Blueprint(rrb.Horizontal(left, plots, column_shares=[3, 2]), panel, collapse_panels=True)


def _eye(extent: Extent) -> rrb.EyeControls3D:
    """Look at the whole flight from the south-west, from a little above its middle."""
    import rerun.blueprint as rrb

    centre_m = (extent.low_m + extent.high_m) / 2
    size_m = float((extent.high_m - extent.low_m).max())
    position_m = centre_m + size_m * _FROM_CENTRE
    return rrb.EyeControls3D(position=position_m, look_target=centre_m, eye_up=(0.0, 0.0, 1.0))

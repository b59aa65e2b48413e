"""Arrangement of the views in Rerun: the flight beside plots and events."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lidar_emu.viewer.timeline import TIMELINE
from lidar_emu.viewer.views import POINTS_S, centre_and_eye_m, plots

if TYPE_CHECKING:
    import rerun.blueprint as rrb

    from lidar_emu.report.ground_below import Extent


def layout(extent: Extent | None, keeps_time: bool, is_running: bool) -> rrb.Blueprint:
    """Arrange the views of a recording.

    Args:
        extent: the box to look at; None: there is no flight to show in three dimensions.
        keeps_time: packets had deadlines, so that there is a lateness.
        is_running: the views follow the newest values, instead of playing from the start.
    """
    import rerun.blueprint as rrb
    from rerun.encodings import TimeRange, TimeRangeBoundary

    legend = rrb.PlotLegend(corner="RightTop")
    curves = rrb.Vertical(
        *(
            rrb.TimeSeriesView(origin=f"/{name}", name=title, plot_legend=legend)
            for name, title in plots(keeps_time).items()
        )
    )
    events = rrb.TextLogView(origin="/events", name="Events")
    panel = rrb.TimePanel(
        timeline=TIMELINE, state="collapsed", play_state="following" if is_running else "playing"
    )
    if extent is None:
        return rrb.Blueprint(rrb.Horizontal(curves, events), panel, collapse_panels=True)
    last = TimeRange(
        start=TimeRangeBoundary.cursor_relative(seconds=-POINTS_S),
        end=TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    flight = rrb.Spatial3DView(
        origin="/site",
        name="Flight",
        eye_controls=_eye(extent),
        overrides={"site/points": rrb.VisibleTimeRanges(rrb.VisibleTimeRange(TIMELINE, last))},
    )
    left = rrb.Vertical(flight, events, row_shares=[4, 1])
    return rrb.Blueprint(rrb.Horizontal(left, curves, column_shares=[3, 2]), panel, collapse_panels=True)


def _eye(extent: Extent) -> rrb.EyeControls3D:
    import rerun.blueprint as rrb

    centre_m, eye_m = centre_and_eye_m(extent)
    return rrb.EyeControls3D(position=eye_m, look_target=centre_m, eye_up=(0.0, 0.0, 1.0))

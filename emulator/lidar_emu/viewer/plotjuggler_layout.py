"""A layout for PlotJuggler: plots of what each beam measured, one above the other.

Format: the elements that PlotJuggler 3 writes. Its parser of ROS 2 names a curve by topic and field.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.viewer.beam_values import beam_values
from lidar_emu.viewer.views import LATENESS, beam_rgb, plots

_MARGIN = 0.05


def write_plotjuggler_layout(run: RecordedRun, path: Path) -> None:
    """Write a layout for a recording's file `.ros2.mcap`.

    Raises:
        InputError: the path cannot be written.
        RunError: writing failed.
    """
    root = _layout(run)
    indent(root, " ")
    with whole_file(path) as file:
        ElementTree(root).write(file, encoding="UTF-8", xml_declaration=True)


def _layout(run: RecordedRun) -> Element:
    titles = plots(run.keeps_time)
    values = beam_values(run.measurement) | {LATENESS: run.lateness_us}
    # Times count from the first of the file.
    times = {"left": "0", "right": f"{np.ptp(run.measurement.time_ns) / 1e9:.6f}"}
    root = Element("root")
    window = SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    tab = SubElement(window, "Tab", containers="1", tab_name="lidar-emu")
    sizes = ";".join([f"{1 / len(titles):.6f}"] * len(titles))
    container = SubElement(tab, "Container")
    stack = SubElement(container, "DockSplitter", orientation="-", count=str(len(titles)), sizes=sizes)
    for name, title in titles.items():
        plot = SubElement(SubElement(stack, "DockArea", name=title), "plot", mode="TimeSeries", style="Lines")
        SubElement(plot, "range", times | _limits(values[name]))
        SubElement(plot, "limitY")
        for number, curve in enumerate(_curves(name, run.measurement.beam_count)):
            SubElement(plot, "curve", name=curve, color=beam_rgb(number))
    SubElement(window, "currentTabIndex", index="0")
    SubElement(root, "use_relative_time_offset", enabled="1")
    return root


def _limits(values: FloatArray) -> dict[str, str]:
    """Limits of the vertical axis, with a margin; of no values 0 and 1."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return {"bottom": "0", "top": "1"}
    margin = _MARGIN * (np.ptp(known) or 1.0)
    return {"bottom": f"{known.min() - margin:.6f}", "top": f"{known.max() + margin:.6f}"}


def _curves(name: str, beam_count: int) -> list[str]:
    topics = ["lateness"] if name == LATENESS else [f"beam_{beam}" for beam in range(beam_count)]
    return [f"/{topic}/{name}/data" for topic in topics]

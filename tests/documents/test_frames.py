"""The picture of the frames shows the beams of the interface documents."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

import lidar_emu
from lidar_emu.report.beam_colours import beam_colour

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "frames.svg"


def test_beams_are_drawn_where_they_point() -> None:
    """Seen from the east of a vehicle that heads north, x is to the right and z down; from above, y is and x up."""
    run = lidar_emu.simulate("descent", level="geometric", duration_s=0.1)
    lines = {
        line.get("id", ""): line
        for line in ElementTree.parse(PICTURE).iter("{http://www.w3.org/2000/svg}line")
    }
    drawn = {name: line for name, line in lines.items() if name}
    assert len(drawn) == 2 * len(run.beam_axis_body[0])
    for beam, (x, y, z) in enumerate(run.beam_axis_body[0]):
        for name, direction in ((f"side-{beam}", (x, z)), (f"above-{beam}", (y, -x))):
            x1, y1, x2, y2 = (float(drawn[name].get(key, "")) for key in ("x1", "y1", "x2", "y2"))
            angle_rad = np.arctan2(y2 - y1, x2 - x1) - np.arctan2(direction[1], direction[0])
            assert abs(angle_rad) < 1e-3
            assert drawn[name].get("stroke") == beam_colour(beam)
    labels = {text.text for text in ElementTree.parse(PICTURE).iter("{http://www.w3.org/2000/svg}text")}
    azimuths_deg = np.degrees(np.arctan2(run.beam_axis_body[0, :, 1], run.beam_axis_body[0, :, 0])) % 360
    assert {f"beam {beam}, {azimuth:.0f}°" for beam, azimuth in enumerate(azimuths_deg)} <= labels

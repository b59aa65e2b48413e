"""A scanned flight over level ground against closed forms, whole and in blocks."""

from __future__ import annotations

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_in_blocks

STEPS = 5
SCAN = {
    "site": "flat",
    "level": "geometric",
    "timing.rate_hz": "7",
    "scanner": f"{{pattern: {{kind: directions, beams: [[4, 0]]}}, scan: {{half_angle_deg: 12, steps: {STEPS}}}}}",
}


def test_lines_follow_one_another_whatever_the_blocks() -> None:
    model = build_model(load("paper_fig4", SCAN))
    assert model.pattern_count == 1
    whole, parts = (Measurement.concatenate(list(measure_in_blocks(model, block))) for block in (1000, 3))
    for name in ("range_m", "closing_speed_mps", "beam_angle_deg", "point_site_m"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
    assert len(whole) > 3 * STEPS

    across = np.radians(-12 + 24 * (whole.shot % STEPS) / (STEPS - 1))
    cosine = np.cos(np.radians(4)) * np.cos(across)
    up_m = whole.position_site_m[:, 2]
    np.testing.assert_allclose(whole.range_m[:, 0], up_m / cosine, rtol=1e-12)
    np.testing.assert_allclose(np.cos(np.radians(whole.beam_angle_deg[:, 0])), cosine, rtol=1e-12)
    np.testing.assert_allclose(whole.point_site_m[:, 0, 0], up_m * np.tan(across), atol=1e-9)
    np.testing.assert_allclose(whole.point_site_m[:, 0, 1], up_m * np.tan(np.radians(4)) / np.cos(across))

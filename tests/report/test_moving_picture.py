"""The moving picture of README: which byte is a beam's, where a point is seen, and how far a shadow reaches."""

from __future__ import annotations

import re
from pathlib import Path

import moon_view
import moving_picture
import numpy as np
import pytest

INTERFACE = Path(__file__).parents[2] / "protocol" / "lidar_protocol" / "INTERFACE.md"


def test_bytes_have_the_colour_of_the_beam_whose_block_they_are_in() -> None:
    found = re.search(r"starts at byte (\d+) \+ (\d+) \* k", INTERFACE.read_text(encoding="utf-8"))
    assert found
    first, length = int(found[1]), int(found[2])
    colours = moving_picture.byte_colours(158)
    assert len(colours) == 158
    for index, colour in enumerate(colours):
        # A delimiter and the first byte of the stuffing come before the packet.
        beam = (index - 2 - first) // length
        assert colour == (moving_picture.LIGHTS[beam] if 0 <= beam < 4 else moving_picture.DIM)


def test_a_point_on_the_ray_of_a_pixel_is_seen_there() -> None:
    camera = moon_view.Camera.aimed(np.array([10.0, -20.0, 30.0]), 500.0, 320.0, 20.0)
    rays = camera.rays()
    seen = camera.pixels(camera.eye_m + 700.0 * rays)
    rows, columns = np.mgrid[: moon_view.HEIGHT, : moon_view.WIDTH] + 0.5
    assert seen[..., 0] == pytest.approx(columns)
    assert seen[..., 1] == pytest.approx(rows)
    assert camera.pixels(np.array([10.0, -20.0, 30.0])) == pytest.approx(
        [moon_view.CENTRE_X, moon_view.CENTRE_Y]
    )
    assert np.isnan(camera.pixels(camera.eye_m - 5.0 * camera.toward)).all()


def test_a_shadow_is_as_long_as_the_sun_is_low() -> None:
    """A block of 10 m by 10 m: behind it the ground is dark as far as its height over the tangent of the sun."""
    height_m, pixel_m, size = 4.0, 0.5, 256
    ground_m = np.zeros((size, size))
    block = slice(size // 2 - 10, size // 2 + 10)
    ground_m[block, block] = height_m
    relief = moon_view.Relief(ground_m, pixel_m)
    away = -moon_view.SUN[:2] / np.hypot(*moon_view.SUN[:2])
    reach_m = height_m / np.tan(np.arcsin(moon_view.SUN[2]))
    # From the edge of the block that the ray through its centre leaves by.
    distance_m = 5.0 / abs(away[0]) + np.array([0.3, 0.85, 1.15]) * reach_m
    for sense, expected in ((1, [0, 0, 1]), (-1, [1, 1, 1])):
        east_m, north_m = size / 2 * pixel_m + sense * away[:, None] * distance_m
        lit = relief.at(east_m, north_m, np.full(3, pixel_m))[2]
        assert lit == pytest.approx(expected, abs=0.1)

"""Points that are distinct on a figure."""

from __future__ import annotations

import numpy as np

from lidar_emu.report.plot_style import distinct


def test_every_point_has_a_selected_one_within_a_dot() -> None:
    random = np.random.default_rng(3)
    x, y = random.uniform(5.0, 7.0, 60_000), random.normal(0.0, 1e-3, 60_000)
    selected = distinct(x, y)
    assert np.all(np.diff(selected) > 0)
    cells = {(int(a), int(b)) for a, b in zip(*_in_cells(x, y), strict=True)}
    near = {(int(a), int(b)) for a, b in zip(*(v[selected] for v in _in_cells(x, y)), strict=True)}
    assert all(any((a + i, b + j) in near for i in (-1, 0, 1) for j in (-1, 0, 1)) for a, b in cells)


def test_points_at_the_same_places_are_drawn_once() -> None:
    x, y = np.tile(np.arange(10.0), 5000), np.tile(np.arange(10.0), 5000)
    np.testing.assert_array_equal(distinct(x, y), np.arange(10))


def test_few_points_are_all_drawn_and_unknown_ones_do_not_widen_the_grid() -> None:
    np.testing.assert_array_equal(distinct(np.zeros(100), np.zeros(100)), np.arange(100))
    x = np.full(30_000, np.nan)
    assert len(distinct(x, x)) == 0
    x[7], x[9] = 1.0, 1.0
    np.testing.assert_array_equal(distinct(x, np.zeros(30_000)), [7])


def _in_cells(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions in dots of a figure of 1000 by 400."""
    return (x - x.min()) / np.ptp(x) * 999, (y - y.min()) / np.ptp(y) * 399

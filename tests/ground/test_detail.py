"""Relief below the pixel: its law across the joining scale, that samples stay, and that a place knows only itself."""

import numpy as np
import pytest

from lidar_emu.scene.mosaic.detail import MARGIN, Law, lattice, law_of, law_with, refine
from lidar_emu.scene.procedural.generate import fractional_surface, structure_function

HALVINGS = 3
FINER = 2**HALVINGS


@pytest.mark.slow
@pytest.mark.parametrize("hurst", [0.3, 0.5, 0.76, 0.95])
def test_goes_on_with_the_law_of_its_base(hurst):
    """The base is every eighth sample of an exact fractional surface, whose other samples say what is right."""
    cells, pixel_m = 128 + 2 * MARGIN, 5.0
    exact_m = 40 * fractional_surface(cells * FINER + 1, hurst, np.random.default_rng(3))
    base_m = exact_m[::FINER, ::FINER]
    law = law_of(base_m, pixel_m)
    assert law.hurst == pytest.approx(hurst, abs=0.03)
    variance = 2 * 40**2 / (cells * pixel_m) ** (2 * hurst)
    assert law.variance_at_1_m == pytest.approx(variance, rel=0.2)
    fine_m = refine(base_m, (-MARGIN, -MARGIN), (pixel_m, pixel_m), HALVINGS, Law(hurst, variance), seed=1)
    np.testing.assert_array_equal(fine_m[::FINER, ::FINER], base_m[MARGIN:-MARGIN, MARGIN:-MARGIN])
    # From an eighth of a pixel to four pixels, through the scale at which the two join.
    lags = np.array([1, 2, 3, 4, 6, 8, 12, 16, 32])
    inner = MARGIN * FINER
    expected = structure_function(exact_m[inner:-inner, inner:-inner], lags)
    np.testing.assert_allclose(structure_function(fine_m, lags), expected, rtol=0.06)


def test_does_not_depend_on_what_is_cut_out():
    rng = np.random.default_rng(5)
    base_m, law = rng.normal(0, 1, (60, 70)), law_with(0.7, 0.05, 2.0)
    whole = refine(base_m, (0, 0), (2.0, 3.0), 4, law, seed=9)
    part = refine(base_m[11:40, 20:51], (11, 20), (2.0, 3.0), 4, law, seed=9)
    np.testing.assert_array_equal(part, whole[11 * 16 :, 20 * 16 :][: part.shape[0], : part.shape[1]])
    other = refine(base_m, (0, 0), (2.0, 3.0), 4, law, seed=10)
    assert np.abs(other - whole).max() > 0.01
    np.testing.assert_array_equal(other[::16, ::16], whole[::16, ::16])


def test_chance_has_no_period_and_no_memory():
    area = lattice((1, 2, 0), (-200, -70), (400, 300))
    np.testing.assert_array_equal(lattice((1, 2, 0), (-13, 40), (50, 60)), area[187:237, 110:170])
    assert area.mean() == pytest.approx(0, abs=4 / np.sqrt(area.size))
    assert area.std() == pytest.approx(1, abs=4 / np.sqrt(2 * area.size))
    for shift in [(0, 1), (1, 0), (128, 0), (0, 128)]:
        again = np.roll(area, shift, (0, 1))[128:, 128:]
        assert abs(np.mean(again * area[128:, 128:])) < 4 / np.sqrt(again.size)
    assert abs(np.mean(lattice((1, 3, 0), (-200, -70), (400, 300)) * area)) < 4 / np.sqrt(area.size)


def test_law_is_read_through_holes_and_tilts():
    surface_m = 10 * fractional_surface(257, 0.7, np.random.default_rng(6))
    plain = law_of(surface_m, 1.0)
    holed = surface_m + 0.3 * np.arange(257)[:, None]
    holed[np.random.default_rng(7).random(holed.shape) < 0.05] = np.nan
    law = law_of(holed, 1.0)
    assert law.hurst == pytest.approx(plain.hurst, abs=0.02)
    assert law.rms_slope(1.0) == pytest.approx(plain.rms_slope(1.0), rel=0.03)
    assert law_of(np.full((40, 40), np.nan), 1.0) is None
    assert law_of(surface_m[:8], 1.0) is None
    assert law_of(np.zeros((40, 40)), 1.0).variance_at_1_m == 0
    assert law_with(0.7, 0.05, 2.0).rms_slope(2.0) == pytest.approx(0.05)


def test_level_ground_stays_level():
    level = refine(np.full((20, 20), 7.5), (0, 0), (1.0, 1.0), 2, Law(0.7, 0.0), seed=1)
    np.testing.assert_allclose(level, 7.5, rtol=1e-14)

"""What came out of the generator beside what was asked, and that the comparison would notice."""

import numpy as np
import pytest
from parts_of_ground import CRATERS, MARS_ROCKS, MOON_ROCKS, RELIEF

from lidar_emu.scene.procedural.compare import compare
from lidar_emu.scene.procedural.generate import (
    generate,
    hurst_exponent,
    rms_slope,
    second_structure_function,
    structure_function,
)

GROUNDS = {
    "mare": {"relief": RELIEF, "craters": CRATERS, "rocks": MOON_ROCKS},
    "highland": {"relief": RELIEF | {"hurst": 0.95, "rms_slope_deg": 8.0}, "craters": {"age_gyr": 4.1}},
    "young and rough": {"relief": RELIEF | {"hurst": 0.3}, "craters": {"age_gyr": 0.05}},
    "mars": {
        "size_m": 51.2, "spacing_m": 0.1, "rocks": MARS_ROCKS, "relief": RELIEF | {"baseline_m": 1.0},
    },
}  # fmt: skip


@pytest.mark.parametrize("name", GROUNDS)
@pytest.mark.parametrize("seed", range(6))
def test_statistics_are_as_asked(ground, name, seed):
    asked = ground(**GROUNDS[name], seed=seed)
    found = compare(asked, generate(asked))
    assert [row for row in found if not row.within] == []
    quantities = " ".join(row.quantity for row in found)
    for part, word in (("relief", "Hurst"), ("craters", "craters larger"), ("rocks", "under rocks")):
        assert (part in GROUNDS[name]) == (word in quantities)


@pytest.mark.parametrize(
    ("part", "other", "quantity"),
    [
        ("relief", {"hurst": 0.9}, "Hurst"),
        ("relief", {"rms_slope_deg": 3.2}, "rms slope"),
        ("craters", {"age_gyr": 0.02}, "craters larger than 4 m"),
        ("craters", {"depth_to_diameter": 0.15}, "crater depth"),
        ("rocks", {"per_m2_over_1_m": 3e-2}, "rocks larger than 2 m"),
        ("rocks", {"per_m2_over_1_m": 3e-2}, "fraction of the ground"),
    ],
)
def test_another_ground_is_distinguished(ground, part, other, quantity):
    keys = {"relief": RELIEF, "craters": CRATERS, "rocks": MOON_ROCKS, "size_m": 512.0}
    made = generate(ground(**keys))
    believed = ground(**(keys | {part: keys[part] | other}))
    rows = [row for row in compare(believed, made) if row.quantity.startswith(quantity)]
    assert len(rows) == 1
    assert not rows[0].within


@pytest.mark.slow
@pytest.mark.parametrize("hurst", [0.2, 0.76, 0.95])
def test_scatter_of_the_estimate_is_what_the_tolerance_reports(hurst):
    from lidar_emu.scene.procedural.generate import fractional_surface

    rng = np.random.default_rng(2)
    found = [hurst_exponent(fractional_surface(129, hurst, rng)) for _ in range(80)]
    assert np.mean(found) == pytest.approx(hurst, abs=0.005)
    assert np.std(found) < 2.0 / 128 * 1.2


def test_structure_functions_of_a_wave_and_a_tilt():
    """A sine of wavelength 16 samples along the columns has 2 a² sin²(pi lag / 16) over whole waves."""
    column = np.arange(16 * 20 + 1)
    wave = np.tile(3.0 * np.sin(2 * np.pi * column / 16), (len(column), 1))
    lags = np.array([1, 4, 8])
    # Half of the pairs lie along the rows, where nothing changes.
    expected = 2 * 9.0 * np.sin(np.pi * lags / 16) ** 2 / 2
    np.testing.assert_allclose(structure_function(wave, lags), expected, rtol=0.01)
    tilt = 0.7 * column + 0.2 * column[:, None]
    np.testing.assert_allclose(structure_function(tilt, lags), (0.49 + 0.04) / 2 * lags**2)
    np.testing.assert_allclose(second_structure_function(tilt, lags), 0.0, atol=1e-20)
    assert rms_slope(tilt, 2.0, 6.0, 0.5) == pytest.approx(((0.49 + 0.04) / 2) ** 0.5 / 2)

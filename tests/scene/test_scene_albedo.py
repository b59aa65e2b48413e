"""Albedo from a band: in the hits, in the echoes, and what is refused."""

import numpy as np
import pytest

import lidar_emu
from lidar_emu.errors import InputError
from lidar_emu.scenario.site import ElevationGrid, Site
from lidar_emu.scene import build_scene

rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")

SIZE, PIXEL_M = 81, 10.0
LEVEL = np.zeros((SIZE, SIZE), dtype=np.float32)


def write(path, *bands, names=("elevation", "albedo")):
    """A level map around 0, 0 without a projection."""
    place = rasterio.Affine(PIXEL_M, 0, -SIZE * PIXEL_M / 2, 0, -PIXEL_M, SIZE * PIXEL_M / 2)
    profile = {"driver": "GTiff", "height": SIZE, "width": SIZE, "dtype": "float32", "transform": place}
    with rasterio.open(path, "w", count=len(bands), **profile) as file:
        for number, band in enumerate(bands, start=1):
            file.write(band.astype(np.float32), number)
            file.set_band_description(number, names[number - 1])
    return path


def scene(path, **keys):
    ground = ElevationGrid(
        kind="grid", file=str(path), **{"reflectance_band": "albedo", "beyond": "plane", **keys}
    )
    return build_scene(Site(ground=ground, surface={"reflectance": 0.07}))


def test_hits_have_the_albedo_of_their_place(tmp_path):
    """A band that is bilinear in the place keeps its values: 0.3 + x/4000 + y/8000 + xy/4e6."""
    step = (np.arange(SIZE) - (SIZE - 1) / 2) * PIXEL_M
    x, y = np.meshgrid(step, -step)
    ground = scene(write(tmp_path / "a.tif", LEVEL, 0.3 + x / 4000 + y / 8000 + x * y / 4e6))
    rng = np.random.default_rng(5)
    origin = np.column_stack([rng.uniform(-500, 500, (300, 2)), np.full(300, 200.0)])
    direction = np.column_stack([rng.uniform(-0.5, 0.5, (300, 2)), np.full(300, -1.0)])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    place = (origin + direction * (200.0 / -direction[:, 2:]))[:, :2]
    on_map = (np.abs(place) <= 400).all(axis=1)
    assert 50 < on_map.sum() < 250
    x, y = place.T
    expected = np.where(on_map, 0.3 + x / 4000 + y / 8000 + x * y / 4e6, 0.07)
    hits = ground.cast(origin, direction)
    np.testing.assert_allclose(hits.reflectance, expected, rtol=0, atol=1e-7)
    upward = ground.cast(origin, -direction)
    assert np.isnan(upward.reflectance).all()


def test_missing_samples_leave_the_albedo_of_the_site(tmp_path):
    band = np.full((SIZE, SIZE), 0.4)
    band[:, : SIZE // 2] = np.nan
    ground = scene(write(tmp_path / "a.tif", LEVEL, band))
    origin = np.array([[-200.0, 0, 100], [200.0, 0, 100]])
    hits = ground.cast(origin, np.tile([0.0, 0, -1], (2, 1)))
    np.testing.assert_allclose(hits.reflectance, [0.07, 0.4], rtol=1e-6)
    assert "albedo 0.4 to 0.4" in ground.description


def test_echoes_are_as_strong_as_the_ground_is_bright(tmp_path):
    """Beams to the east and to the west, over four times as bright ground: 6.02 dB."""
    band = np.full((SIZE, SIZE), 0.1)
    band[:, SIZE // 2 + 1 :] = 0.4
    write(tmp_path / "a.tif", LEVEL, band)
    (tmp_path / "a.yaml").write_text(
        "name: a\ntiming: {rate_hz: 10}\n"
        "instrument: ndl_as_published\n"
        "scanner: {pattern: {kind: directions, beams: [[20, 90], [20, 270]]}}\n"
        "trajectory: {kind: profile, waypoints: [{altitude_m: 500, speed_mps: 5}, {altitude_m: 490, speed_mps: 5}]}\n"
        "site: {name: a, ground: {kind: grid, file: a.tif, reflectance_band: albedo}}\n"
    )
    run = lidar_emu.simulate(lidar_emu.load(tmp_path / "a.yaml"), seed=1)
    assert run.range_valid.all()
    apart_db = run.snr_db[:, 0] - run.snr_db[:, 1]
    assert apart_db.mean() == pytest.approx(10 * np.log10(4), abs=0.1)


@pytest.mark.parametrize(
    ("band", "keys", "expected"),
    [
        (
            0.3,
            {"reflectance_band": "ldam"},
            "must be 'elevation', 'albedo', or a number from 1 to 2 (got 'ldam')",
        ),
        (30.0, {}, "ground.reflectance_band: must hold numbers from 0 to 1 (got 30.0)"),
        (
            -1.0,
            {"reflectance_band": None, "rock_abundance_band": 2},
            "rock_abundance_band: must hold numbers from 0 to 1",
        ),
    ],
)
def test_bands_that_are_refused(tmp_path, band, keys, expected):
    path = write(tmp_path / "a.tif", LEVEL, LEVEL + band)
    with pytest.raises(InputError) as caught:
        scene(path, **keys)
    assert expected in str(caught.value)


def test_an_npz_has_elevations_only(tmp_path):
    np.savez(tmp_path / "a.npz", elevation_m=LEVEL, pixel_m=PIXEL_M)
    with pytest.raises(InputError, match=r"reflectance_band: leave it out: a \.npz file"):
        scene(tmp_path / "a.npz")


def test_rock_abundance_is_reported(tmp_path):
    path = write(tmp_path / "a.tif", LEVEL, LEVEL + 0.02)
    ground = scene(path, reflectance_band=None, rock_abundance_band=2)
    assert "rock abundance 0.02 to 0.02 (median 0.02)" in ground.description

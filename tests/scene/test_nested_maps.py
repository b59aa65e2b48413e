"""Maps of different projections, placed around one point of the body, agree where they overlap."""

from pathlib import Path

import numpy as np
import pytest

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import Site
from lidar_emu.scene import build_scene

RADIUS_M = 1_737_400.0
LATITUDE_DEG, LONGITUDE_DEG = 27.0, -52.0


def elevation_m(longitude_deg, latitude_deg):
    """Hills a kilometre and more across."""
    north = np.radians(latitude_deg - LATITUDE_DEG) * RADIUS_M
    east = np.radians(longitude_deg - LONGITUDE_DEG) * RADIUS_M * np.cos(np.radians(LATITUDE_DEG))
    return 60 * np.sin(east / 900) * np.cos(north / 700) - 1500


def write(path: Path, projection: str, centre_m, pixel_m: float, side: int, offset_m: float = 0.0) -> None:
    rasterio = pytest.importorskip("rasterio")
    pyproj = pytest.importorskip("pyproj")
    first_m = centre_m[0] - pixel_m * side / 2, centre_m[1] + pixel_m * side / 2
    place = (np.arange(side) + 0.5) * pixel_m
    x, y = np.meshgrid(first_m[0] + place, first_m[1] - place)
    height = elevation_m(*pyproj.Proj(projection)(x, y, inverse=True)) + offset_m
    transform = rasterio.Affine(pixel_m, 0, first_m[0], 0, -pixel_m, first_m[1])
    shape = {"height": side, "width": side, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", driver="GTiff", crs=projection, transform=transform, **shape) as file:
        file.write(height.astype("float32"), 1)


@pytest.mark.slow
def test_maps_of_two_projections_fit_into_each_other(tmp_path):
    sphere = f"+R={RADIUS_M} +units=m +no_defs"
    wide = f"+proj=ortho +lat_0=27.2 +lon_0=-52.1 {sphere}"
    # Centred on the site; the map's own centre and that of the wide one are elsewhere.
    fine = f"+proj=eqc +lat_ts=25 +lat_0=0 +lon_0=-50 {sphere}"
    pyproj = pytest.importorskip("pyproj")
    write(tmp_path / "wide.tif", wide, (0, 0), 40.0, 800)
    write(tmp_path / "fine.tif", fine, pyproj.Proj(fine)(LONGITUDE_DEG, LATITUDE_DEG), 5.0, 300, 3.0)
    grids = [
        {"kind": "grid", "file": str(tmp_path / "fine.tif")},
        {"kind": "grid", "file": str(tmp_path / "wide.tif"), "beyond": "sphere"},
    ]
    grids[0]["origin"] = {"latitude_deg": LATITUDE_DEG, "longitude_deg": LONGITUDE_DEG}
    scene = build_scene(Site.model_validate({"ground": {"kind": "nested", "grids": grids}}))
    assert scene.seam.offset_m == pytest.approx(3.0, abs=0.02)
    assert scene.seam.scatter_m < 0.05
    # With the datum set right the two are one surface, which falls away with the body.
    grids[0]["elevation_offset_m"] = -3.0
    scene = build_scene(Site.model_validate({"ground": {"kind": "nested", "grids": grids}}))
    east = np.linspace(-4000, 4000, 801)
    expected = elevation_m(
        LONGITUDE_DEG + np.degrees(east / RADIUS_M / np.cos(np.radians(LATITUDE_DEG))), LATITUDE_DEG
    )
    expected = expected - expected[400] - east**2 / (2 * RADIUS_M)
    np.testing.assert_allclose(scene.height_m(east, np.zeros(801)), expected, rtol=0, atol=0.5)
    inner = np.abs(east) < 600
    np.testing.assert_allclose(
        scene.height_m(east[inner], np.zeros(inner.sum())), expected[inner], rtol=0, atol=0.05
    )


def test_a_map_that_does_not_reach_the_site_is_refused(tmp_path):
    sphere = f"+proj=ortho +lat_0=27 +lon_0=-52 +R={RADIUS_M} +units=m +no_defs"
    write(tmp_path / "fine.tif", sphere, (0, 0), 5.0, 100)
    write(tmp_path / "wide.tif", sphere, (90_000, 0), 50.0, 100)
    grids = [{"kind": "grid", "file": str(tmp_path / name)} for name in ("fine.tif", "wide.tif")]
    with pytest.raises(InputError, match=r"wide\.tif"):
        build_scene(Site.model_validate({"ground": {"kind": "nested", "grids": grids}}))

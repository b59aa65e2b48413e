"""Maps of planetocentric latitudes: to the map and back, against PROJ by way of Cartesian coordinates."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from lidar_emu.scene.terrain.raster import Projection

pytest.importorskip("rasterio")

# Mars (2015) / Ocentric / Equirectangular and North Polar: what each makes of longitude and planetocentric latitude.
MAPS = {
    "equirectangular": ("IAU_2015:49912", "+proj=eqc", -85.0),
    "north polar": ("IAU_2015:49932", "+proj=stere +lat_0=90", 20.0),
}


def radius_latitude_deg(crs: pyproj.CRS, latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> np.ndarray:
    """Angle of the radius to points of the ellipsoid at latitudes of the normal, from PROJ's x, y and z."""
    a, b = crs.ellipsoid.semi_major_metre, crs.ellipsoid.semi_minor_metre
    to_cartesian = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +a={a} +b={b}"
    )
    x, y, z = to_cartesian.transform(longitude_deg, latitude_deg, np.zeros_like(latitude_deg))
    return np.degrees(np.arctan2(z, np.hypot(x, y)))


@pytest.mark.parametrize("name", MAPS)
def test_planetocentric_maps_and_their_inverse_agree_with_proj(name: str) -> None:
    code, operation, southernmost_deg = MAPS[name]
    crs = pyproj.CRS.from_user_input(code)
    a, b = crs.ellipsoid.semi_major_metre, crs.ellipsoid.semi_minor_metre
    rng = np.random.default_rng(4)
    latitude_deg = rng.uniform(southernmost_deg, 89.0, 200)
    longitude_deg = rng.uniform(-179.0, 179.0, 200)
    centric_deg = radius_latitude_deg(crs, latitude_deg, longitude_deg)
    # On Mars the two differ by up to 0.34 degrees, 20 km: neither may stand for the other.
    assert np.abs(latitude_deg - centric_deg).max() > 0.3
    x, y = pyproj.Proj(f"{operation} +a={a} +b={b}")(longitude_deg, centric_deg)

    projection = Projection(crs.to_wkt())
    found_x, found_y = projection.map_xy(np.radians(latitude_deg), np.radians(longitude_deg))
    np.testing.assert_allclose(found_x, x, atol=1e-5)
    np.testing.assert_allclose(found_y, y, atol=1e-5)
    found_latitude, found_longitude = projection.geodetic(x, y)
    np.testing.assert_allclose(np.degrees(found_latitude), latitude_deg, atol=1e-9)
    np.testing.assert_allclose(np.degrees(found_longitude), longitude_deg, atol=1e-9)

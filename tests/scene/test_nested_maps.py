"""Maps without a position of their own lie around the first one's place on the body."""

import numpy as np
import pytest

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import Site
from lidar_emu.scene import build_scene

rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")

MOON = "+proj=ortho +lat_0=27 +lon_0=-52 +R=1737400 +units=m +no_defs"


def test_a_map_that_does_not_reach_the_site_is_refused(tmp_path):
    for name, east_m, pixel_m in (("fine.tif", 0.0, 5.0), ("wide.tif", 90_000.0, 50.0)):
        place = rasterio.Affine(pixel_m, 0, east_m - 50 * pixel_m, 0, -pixel_m, 50 * pixel_m)
        shape = {"height": 100, "width": 100, "count": 1, "dtype": "float32", "transform": place}
        with rasterio.open(tmp_path / name, "w", driver="GTiff", crs=MOON, **shape) as file:
            file.write(np.zeros((100, 100), dtype=np.float32), 1)
    grids = [{"kind": "grid", "file": str(tmp_path / name)} for name in ("fine.tif", "wide.tif")]
    with pytest.raises(
        InputError, match=r"wide\.tif: ground.origin: latitude 27, longitude -52, off the grid"
    ):
        build_scene(Site.model_validate({"ground": {"kind": "nested", "grids": grids}}))

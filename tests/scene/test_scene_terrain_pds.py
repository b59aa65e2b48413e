"""PDS images by their labels, written here as the archives write them."""

import re

import numpy as np
import pytest
from twins import pds_label

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.raster import open_raster
from lidar_emu.scene.terrain.read import read_terrain

pytest.importorskip("rasterio", reason="the extra geo is not installed")

LOLA = {
    "data_set": "LRO-L-LOLA-4-GDR-V1.0",
    "sample_type": "LSB_INTEGER",
    "scale": 0.5,
    "radius_km": 1737.4,
    "counted_from": -0.5,
}
MOLA = {}


def write_pds(folder, label):
    """A hill of one sample at latitude 24.5 north, longitude 40.5 east: of a degree, it is centred in its pixel."""
    values = np.zeros((180, 360), dtype="<i2" if "sample_type" in label else ">i2")
    values[65, 40] = 1000
    (folder / "map.img").write_bytes(values.tobytes())
    (folder / "map.lbl").write_text(pds_label("map.img", **label))
    return folder / "map.lbl"


def elevation_at(path, latitude_deg, longitude_deg, **keys):
    origin = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
    return read_terrain(ElevationGrid(kind="grid", file=str(path), origin=origin, **keys)).origin_elevation_m


@pytest.mark.parametrize(("label", "height_m"), [(LOLA, 500.0), (MOLA, 1000.0)])
def test_a_sample_is_found_in_its_degree(tmp_path, label, height_m):
    """LOLA's labels count from the first sample, MOLA's from a pixel before it: both mean the same places."""
    path = write_pds(tmp_path, label)
    assert elevation_at(path, 24.5, 40.5) == pytest.approx(height_m, rel=0.01)
    assert elevation_at(path, 25.5, 40.5) == pytest.approx(0, abs=0.01 * height_m)
    assert elevation_at(path, 24.5, 39.5) == pytest.approx(0, abs=0.01 * height_m)


def test_a_polar_image(tmp_path):
    """Seen from below the south pole: longitude 0 is up on the map, 90 east to the right, at the map's own scale."""
    label = pds_label("map.img", **LOLA)
    for key, value in {
        "MAP_PROJECTION_TYPE": '"POLAR STEREOGRAPHIC"',
        "CENTER_LATITUDE": "-90 <DEGREE>",
        "CENTER_LONGITUDE": "0.0 <DEGREE>",
        "LINES": 360,
        "MAP_SCALE": "1.0 <KM/PIXEL>",
        "LINE_PROJECTION_OFFSET": 179.5,
    }.items():
        label = re.sub(rf"(?m)^( +{key} = ).*", rf"\g<1>{value}", label)
    values = np.zeros((360, 360), dtype="<i2")
    values[80, 180 + 40] = 1000
    (tmp_path / "map.img").write_bytes(values.tobytes())
    (tmp_path / "map.lbl").write_text(label)
    x_m, y_m = 40_500.0, 99_500.0
    # Snyder 21-1 and 21-2 on the sphere, true scale at the pole: rho = 2 R tan(colatitude / 2).
    colatitude = 2 * np.arctan(np.hypot(x_m, y_m) / (2 * 1_737_400.0))
    latitude_deg, longitude_deg = np.degrees(colatitude) - 90, np.degrees(np.arctan2(x_m, y_m))
    assert elevation_at(tmp_path / "map.lbl", latitude_deg, longitude_deg) == pytest.approx(500.0, rel=1e-6)
    assert elevation_at(tmp_path / "map.lbl", latitude_deg, -longitude_deg) == 0


def test_unit_of_the_label(tmp_path):
    path = write_pds(tmp_path, LOLA | {"unit": "KILOMETER", "scale": 0.001})
    assert elevation_at(path, 24.5, 40.5) == pytest.approx(1000.0, rel=0.01)
    assert elevation_at(path, 24.5, 40.5, elevation_scale=1.0) == pytest.approx(1.0, rel=0.01)


def test_radii_instead_of_elevations(tmp_path):
    path = write_pds(tmp_path, LOLA | {"offset": 1737400})
    with pytest.raises(InputError) as caught:
        elevation_at(path, 24.5, 40.5)
    assert "make them heights with ground.elevation_offset_m: -1737400" in str(caught.value)
    assert elevation_at(path, 24.5, 40.5, elevation_offset_m=-1737400.0) == pytest.approx(500.0, rel=0.01)


def test_the_image_instead_of_its_label(tmp_path):
    path = write_pds(tmp_path, LOLA)
    with pytest.raises(InputError, match=r"the label of the PDS image, such as map\.lbl"):
        elevation_at(path.with_suffix(".img"), 0, 0)


@pytest.mark.parametrize("text", ["", "PDS_VERSION_ID = PDS3\nEND\n", pds_label("map.img")[:200]])
def test_damaged_labels(tmp_path, text):
    path = write_pds(tmp_path, LOLA)
    path.write_text(text)
    with pytest.raises(InputError, match="unreadable"):
        elevation_at(path, 0, 0)


def test_an_image_that_is_cut_short(tmp_path):
    path = write_pds(tmp_path, LOLA)
    image = path.with_suffix(".img")
    image.write_bytes(image.read_bytes()[:1000])
    with pytest.raises(InputError, match="unreadable"), open_raster(str(path)) as file:
        file.read(1)

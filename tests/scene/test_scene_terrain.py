"""Elevation files: what is read, where it comes to lie, and what is refused in one line."""

import struct
import sys
import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import ElevationGrid, Site
from lidar_emu.scene import build_scene
from lidar_emu.scene.terrain.flat import read_flat_raster
from lidar_emu.scene.terrain.raster import open_raster
from lidar_emu.scene.terrain.read import read_npz, read_terrain

rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")

MOON = "+proj=ortho +lat_0=25 +lon_0=-46 +R=1737400 +units=m"
PLACE = (2.0, 0, 100.0, 0, -2.0, 300.0)
RAMP = np.arange(20, dtype=np.float32).reshape(4, 5) * 10


def grid(path, **keys):
    return ElevationGrid(kind="grid", file=str(path), **keys)


def scene(path, site=None, **keys):
    return build_scene(Site(ground=grid(path, **keys), **(site or {})))


def flat_map(path, **keys):
    """A file on its own map."""
    ground = grid(path, placement="flat", **keys)
    if path.suffix == ".npz":
        return read_npz(ground)
    with open_raster(str(path)) as file:
        return read_flat_raster(ground, file)


def test_an_npz_does_not_unpack_a_header_without_end(tmp_path):
    path = tmp_path / "dem.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(
            "elevation_m.npy", b"\x93NUMPY\x02\x00" + struct.pack("<I", 50_000_000) + bytes(50_000_000)
        )
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="elevation_m has a header for structured arrays"):
            read_npz(ElevationGrid(kind="grid", file=str(path)))
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


def write_npz(path, **arrays):
    np.savez(path, **({"elevation_m": RAMP, "pixel_m": 2.0} | arrays))
    return path


def write_tiff(path, *bands, names=(), crs=MOON, transform=PLACE, point=False, nodata=None):
    bands = bands or (RAMP,)
    rows, columns = bands[0].shape
    profile = {"driver": "GTiff", "count": len(bands), "dtype": bands[0].dtype, "nodata": nodata, "crs": crs}
    if transform is not None:
        profile["transform"] = rasterio.Affine(*transform)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        file = rasterio.open(path, "w", height=rows, width=columns, **profile)
    with file:
        file.update_tags(AREA_OR_POINT="Point" if point else "Area")
        for number, band in enumerate(bands, start=1):
            file.write(band, number)
        for number, name in enumerate(names, start=1):
            file.set_band_description(number, name)
    return path


def write_ascii(path, corner="xllcorner"):
    header = ["ncols 3", "nrows 2", f"{corner} 10", f"{corner.replace('x', 'y', 1)} 20", "cellsize 4"]
    path.write_text("\n".join([*header, "NODATA_value -9999", "1 2 3", "4 -9999 6"]) + "\n")
    return path


def refusal(call, *args, **keys):
    """The one line with which a call is refused."""
    with pytest.raises(InputError) as caught:
        call(*args, **keys)
    line = str(caught.value)
    assert "\n" not in line
    assert "; " in line or "(got " in line
    return line


# -- the site frame


def test_rows_run_from_north_to_south(tmp_path):
    ground = scene(write_npz(tmp_path / "a.npz"))
    # Five columns and four rows at 2 m: the centre is the middle of the grid, 95 m high.
    assert ground.origin_altitude_m == 95.0
    east, north = np.array([0.0, -4.0, 4.0, 4.0]), np.array([0.0, 3.0, 3.0, -3.0])
    np.testing.assert_array_equal(ground.height_m(east, north), [0, 0 - 95, 40 - 95, 190 - 95])
    assert ground.description == (
        "grid a.npz, 5 x 4 samples at 2 m, 8 m x 6 m, heights 0 to 190 m, largest step 50 m; beyond: none"
    )


def test_origin_altitude_shifts_the_ground(tmp_path):
    ground = scene(write_npz(tmp_path / "a.npz"), {"origin_altitude_m": 100.0}, beyond="plane")
    assert ground.origin_altitude_m == 100.0
    np.testing.assert_array_equal(ground.height_m(np.array([0.0, 99.0]), np.zeros(2)), [-5.0, 0.0])


def test_sphere_beyond_goes_through_the_origin(tmp_path):
    ground = scene(write_npz(tmp_path / "a.npz"), {"body": {"radius_m": 1e6}}, beyond="sphere")
    height = ground.height_m(np.array([5000.0]), np.array([0.0]))
    np.testing.assert_allclose(height, -(5000.0**2) / (2 * (1e6 + 95)), rtol=1e-5)


def test_map_origin_and_its_refusals(tmp_path):
    with_map = write_npz(tmp_path / "a.npz", map_x_m=1000.0, map_y_m=500.0)
    ground = scene(with_map, origin={"map_x_m": 1002.0, "map_y_m": 496.0})
    assert ground.origin_altitude_m == RAMP[2, 1]
    assert (ground.samples.west_m, ground.samples.south_m) == (-2.0, -2.0)
    between = scene(with_map, origin={"map_x_m": 1003.0, "map_y_m": 495.5})
    assert between.origin_altitude_m == RAMP[2, 1] + 0.5 * 10 + 0.25 * 50
    line = refusal(scene, with_map, origin={"map_x_m": 1009.0, "map_y_m": 496.0})
    assert "off the grid" in line
    assert "x from 1000 to 1008 m, y from 494 to 500 m" in line
    without = write_npz(tmp_path / "b.npz")
    assert "ground.origin.map_x_m" in refusal(scene, without, origin={"map_x_m": 0.0, "map_y_m": 0.0})
    line = refusal(scene, with_map, origin={"latitude_deg": 1.0, "longitude_deg": 2.0})
    assert "the file states no projection" in line


def test_origin_on_missing_samples(tmp_path):
    hole = np.where(np.arange(20).reshape(4, 5) == 12, np.nan, RAMP)
    path = write_npz(tmp_path / "a.npz", elevation_m=hole)
    assert "samples are missing" in refusal(scene, path)
    path = write_npz(tmp_path / "a.npz", elevation_m=hole, map_x_m=0.0, map_y_m=0.0)
    assert "5.00% missing" in scene(path, origin={"map_x_m": 1.0, "map_y_m": -1.0}).description


# -- numbers


def test_scale_offset_and_markers(tmp_path):
    stored = np.array([[1, 2, -32768], [4, 5, 6]], dtype=np.int16)
    path = write_npz(tmp_path / "a.npz", elevation_m=stored)
    terrain = flat_map(path, nodata=-32768.0, elevation_scale=0.5, elevation_offset_m=100.0)
    np.testing.assert_array_equal(terrain.elevation_m, [[100.5, 101, np.nan], [102, 102.5, 103]])


def test_marker_in_the_precision_of_the_file(tmp_path):
    stored = np.array([[1, -3.4028235e38], [np.inf, 4]], dtype=np.float32)
    path = write_npz(tmp_path / "a.npz", elevation_m=stored)
    terrain = flat_map(path, nodata=-3.40282347e38)
    np.testing.assert_array_equal(terrain.elevation_m, [[1, np.nan], [np.nan, 4]])


def test_markers_and_scales_that_a_raster_states(tmp_path):
    stored = np.array([[10, 20, -1], [40, 50, 7]], dtype=np.int16)
    path = write_tiff(tmp_path / "a.tif", stored, nodata=-1)
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (0.5,), (1000.0,)
    terrain = flat_map(path, nodata=7.0, elevation_offset_m=-5.0)
    np.testing.assert_array_equal(terrain.elevation_m, [[1000, 1005, np.nan], [1015, 1020, np.nan]])


@pytest.mark.parametrize("nodata", [-np.inf, np.nan, -3.4028234663852886e38])
def test_markers_of_floating_point_rasters(tmp_path, nodata):
    band = RAMP.copy()
    band[0, 0] = nodata
    terrain = flat_map(write_tiff(tmp_path / "a.tif", band, nodata=nodata))
    np.testing.assert_array_equal(np.isnan(terrain.elevation_m), np.arange(20).reshape(4, 5) == 0)


# -- npz that is refused


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"elevation_m": np.zeros(5)}, "elevation_m: float64 of shape (5,)"),
        ({"elevation_m": np.zeros((3, 3), dtype=complex)}, "complex128"),
        ({"elevation_m": np.array([["a", "b"], ["c", "d"]])}, "elevation_m"),
        ({"elevation_m": np.array([[None, 1], [2, 3]])}, "elevation_m: object of shape (2, 2)"),
        ({"elevation_m": np.zeros((1, 9))}, "9 x 1 samples"),
        ({"elevation_m": np.full((3, 3), np.nan)}, "every sample is missing"),
        ({"pixel_m": -1.0}, "pixel_m: must be positive (got -1.0)"),
        ({"pixel_m": np.array([1.0, 2.0])}, "pixel_m"),
        ({"pixel_m": np.nan}, "pixel_m"),
        ({"map_x_m": 1.0}, "map_y_m: missing"),
        ({"map_x_m": np.nan, "map_y_m": 0.0}, "map_x_m: must be one finite number (got nan)"),
        ({"map_x_m": np.array("east"), "map_y_m": 0.0}, "map_x_m: <U4 of shape ()"),
        ({"elevations": np.zeros(2)}, "elevations: an unknown array"),
    ],
)
def test_npz_that_is_refused(tmp_path, arrays, expected):
    assert expected in refusal(scene, write_npz(tmp_path / "a.npz", **arrays))


def test_an_npz_that_declares_too_much_is_refused_by_its_header(tmp_path, monkeypatch):
    """A few kilobytes that would unpack to 3.2 GB."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        with archive.open("elevation_m.npy", "w") as entry:
            header = {"descr": "<f8", "fortran_order": False, "shape": (20_000, 20_000)}
            np.lib.format.write_array_header_1_0(entry, header)
        with archive.open("pixel_m.npy", "w") as entry:
            np.lib.format.write_array(entry, np.array(2.0))
    monkeypatch.setattr(np.lib.format, "read_array", None)
    assert "20000 x 20000 samples" in refusal(scene, tmp_path / "a.npz")


def test_damaged_npz(tmp_path):
    intact = write_npz(tmp_path / "a.npz").read_bytes()
    array = tmp_path / "array.npy"
    np.save(array, RAMP)
    middle = intact[:150] + bytes([intact[150] ^ 1]) + intact[151:]
    for content in (b"", b"no archive", intact[:200], intact[:-30], middle, array.read_bytes()):
        path = tmp_path / "damaged.npz"
        path.write_bytes(content)
        assert "damaged.npz: unreadable" in refusal(scene, path)


def test_keys_that_an_npz_cannot_follow(tmp_path):
    path = write_npz(tmp_path / "a.npz")
    assert "ground.band: must be elevation, all that a .npz" in refusal(scene, path, band="slope")


def test_a_flat_grid_is_taken_whole(tmp_path):
    for path in (write_npz(tmp_path / "a.npz"), write_ascii(tmp_path / "a.asc")):
        line = refusal(scene, path, half_size_m=4.0)
        assert "ground.half_size_m: leave it out: a flat grid is taken whole (got 4.0)" in line


def test_file_that_is_not_there(tmp_path):
    assert "no such file" in refusal(scene, tmp_path / "a.tif")
    assert "a folder" in refusal(scene, tmp_path)


# -- rasters


def test_samples_sit_at_the_centres_of_their_pixels(tmp_path):
    terrain = flat_map(write_tiff(tmp_path / "a.tif"))
    assert (terrain.first_x_m, terrain.first_y_m) == (101.0, 299.0)
    assert (terrain.last_x_m, terrain.last_y_m) == (109.0, 293.0)
    np.testing.assert_array_equal(terrain.elevation_m, RAMP)


def test_tie_point_of_a_file_of_points(tmp_path):
    """GDAL returns the stored value when it ignores the convention: there the first sample lies."""
    path = write_tiff(tmp_path / "a.tif", point=True)
    with rasterio.Env(GTIFF_POINT_GEO_IGNORE=True), rasterio.open(path) as file:
        tie = (file.transform.c, file.transform.f)
    assert tie == (101.0, 299.0)
    terrain = flat_map(path)
    assert (terrain.first_x_m, terrain.first_y_m) == tie


@pytest.mark.parametrize(("corner", "first"), [("xllcorner", (12, 26)), ("xllcenter", (10, 24))])
def test_esri_ascii(tmp_path, corner, first):
    terrain = flat_map(write_ascii(tmp_path / "a.asc", corner))
    assert (terrain.first_x_m, terrain.first_y_m) == first
    np.testing.assert_array_equal(terrain.elevation_m, [[1, 2, 3], [4, np.nan, 6]])


def test_rectangular_pixels(tmp_path):
    path = write_tiff(tmp_path / "a.tif", transform=(2.0, 0, 0.0, 0, -5.0, 0.0))
    ground = scene(path, placement="flat")
    assert "5 x 4 samples at 2 m x 5 m" in ground.description
    assert (ground.samples.west_m, ground.samples.south_m) == (-4.0, -7.5)


def test_bands(tmp_path):
    path = write_tiff(tmp_path / "a.tif", RAMP + 1, RAMP + 2, names=("slope", "Elevation"))
    assert flat_map(path).elevation_m[0, 0] == 2
    assert flat_map(path, band="SLOPE").elevation_m[0, 0] == 1
    assert flat_map(path, band=1).elevation_m[0, 0] == 1
    line = refusal(scene, path, band="dem")
    assert (
        "ground.band: must be the band of elevations: 'slope', 'Elevation', or a number from 1 to 2" in line
    )
    assert "or a number from 1 to 2 (got 3)" in refusal(scene, path, band=3)
    twice = write_tiff(tmp_path / "b.tif", RAMP, RAMP, names=("elevation", "elevation"))
    assert "ground.band" in refusal(scene, twice)
    single = write_tiff(tmp_path / "c.tif", names=("dem",))
    assert flat_map(single).elevation_m[0, 1] == 10
    assert "'dem', or a number from 1 to 1" in refusal(scene, single, band="slope")


def test_latitude_and_longitude_on_a_flat_map(tmp_path):
    path = write_tiff(tmp_path / "a.tif", transform=(2000.0, 0, -5000.0, 0, -2000.0, 4000.0))
    # Snyder, Map Projections: a Working Manual, equations 20-3 and 20-4.
    lat, lat0, dlon = np.radians([25.03, 25.0, 0.05])
    x_m = 1737400 * np.cos(lat) * np.sin(dlon)
    y_m = 1737400 * (np.cos(lat0) * np.sin(lat) - np.sin(lat0) * np.cos(lat) * np.cos(dlon))
    for longitude_deg in (-45.95, 360 - 45.95):
        origin = {"latitude_deg": 25.03, "longitude_deg": longitude_deg}
        terrain = read_terrain(grid(path, placement="flat", origin=origin))
        assert (terrain.west_m, terrain.north_m) == pytest.approx((-4000 - x_m, 3000 - y_m), abs=1e-6)
    keys = {"placement": "flat", "origin": {"latitude_deg": 26.0, "longitude_deg": -46.0}}
    assert "off the grid" in refusal(scene, path, **keys)
    keys["origin"] = {"latitude_deg": -25.0, "longitude_deg": 134.0}
    assert "latitude -25, longitude 134" in refusal(scene, path, **keys)


def test_planetocentric_latitude_on_an_ellipsoid(tmp_path):
    """Mercator on the ellipsoid of Mars (Snyder, equation 7-7) is a function of planetographic latitude."""
    a_m, b_m = 3396190.0, 3376200.0
    crs = f"+proj=merc +a={a_m} +b={b_m} +units=m"
    path = write_tiff(tmp_path / "a.tif", crs=crs, transform=(2e6, 0, -5e6, 0, -2e6, 4e6))
    origin = {"latitude_deg": 30.0, "longitude_deg": 10.0}
    terrain = read_terrain(grid(path, placement="flat", origin=origin))
    graphic = np.arctan(np.tan(np.radians(30.0)) * (a_m / b_m) ** 2)
    e = np.sqrt(1 - (b_m / a_m) ** 2)
    y_m = a_m * (np.arctanh(np.sin(graphic)) - e * np.arctanh(e * np.sin(graphic)))
    assert (terrain.west_m, terrain.north_m) == pytest.approx(
        (-4e6 - a_m * np.radians(10.0), 3e6 - y_m), abs=1e-3
    )


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"transform": None, "crs": None}, "no georeference"),
        ({"transform": (2.0, 0.1, 0, 0.1, -2.0, 0)}, "rotated"),
        ({"transform": (2.0, 0, 0, 0, 2.0, 0)}, "mirrored"),
        ({"crs": "EPSG:4326", "transform": (0.01, 0, 10, 0, -0.01, 50)}, "in degrees"),
        ({"crs": "+proj=utm +zone=10 +datum=NAD83 +units=us-ft"}, "a map in US survey foot"),
    ],
)
def test_maps_that_cannot_lie_flat(tmp_path, keys, expected):
    assert expected in refusal(scene, write_tiff(tmp_path / "a.tif", **keys), placement="flat")


def test_rasters_that_are_refused(tmp_path):
    empty = write_tiff(tmp_path / "a.tif", np.full((3, 3), np.nan))
    assert "every sample is missing" in refusal(scene, empty, placement="flat")
    assert "ground.origin: the grid's centre, where samples are missing; choose a point" in refusal(
        scene, empty
    )
    assert "3 x 1 samples" in refusal(scene, write_tiff(tmp_path / "b.tif", np.zeros((1, 3))))
    assert "complex64" in refusal(scene, write_tiff(tmp_path / "c.tif", np.zeros((3, 3), dtype=np.complex64)))
    intact = write_tiff(tmp_path / "d.tif", np.zeros((300, 300))).read_bytes()
    for content in (b"", b"no raster", intact[: len(intact) // 2]):
        path = tmp_path / "damaged.tif"
        path.write_bytes(content)
        assert "damaged.tif: unreadable" in refusal(scene, path)


def test_without_rasterio(tmp_path, monkeypatch):
    path = write_tiff(tmp_path / "a.tif")
    monkeypatch.setitem(sys.modules, "rasterio", None)
    assert refusal(scene, path).endswith("[geo]'")
    assert scene(write_npz(tmp_path / "a.npz")).origin_altitude_m == 95.0


# -- real maps

"""Maps placed on the body: held against PROJ's own chain to the local horizon, and closed forms of Snyder's.

Snyder, Map Projections: a Working Manual (USGS Professional Paper 1395).
"""

import numpy as np
import pytest

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import ElevationGrid, Site
from lidar_emu.scene import build_scene
from lidar_emu.scene.terrain.model import Ellipsoid, LocalFrame
from lidar_emu.scene.terrain.read import read_terrain

rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")
pyproj = pytest.importorskip("pyproj", reason="needs pyproj")

MOON_M = 1_737_400.0
MARS_M = (3_396_190.0, 3_376_200.0)
MAPS = {
    "orthographic": ("+proj=ortho +lat_0=25 +lon_0=-46 +R=1737400", 25.0, -46.0),
    "equirectangular": ("+proj=eqc +lat_ts=18 +lon_0=180 +R=3394839.8", 18.4, 77.5),
    "south polar stereographic": ("+proj=stere +lat_0=-90 +lon_0=0 +R=1737400", -85.3, 41.0),
    "north polar stereographic, ellipsoid": (
        f"+proj=stere +lat_0=90 +a={MARS_M[0]} +b={MARS_M[1]}",
        83.0,
        -120.0,
    ),
}


def relief_m(longitude_deg, latitude_deg):
    """Smooth ground over the whole body, some hundred metres high."""
    lon, lat = np.radians(longitude_deg), np.radians(latitude_deg)
    x, y, z = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    return 300.0 * np.sin(400 * x + 1.0) * np.cos(500 * y) + 200.0 * np.sin(600 * z)


def body_of(crs):
    ellipsoid = pyproj.CRS(crs).ellipsoid
    return ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre


def write(path, crs, place, band):
    """A band in a file, and the path."""
    rows, columns = band.shape
    profile = {"driver": "GTiff", "height": rows, "width": columns, "dtype": "float64", "transform": place}
    with rasterio.open(path, "w", count=1, crs=crs, **profile) as file:
        file.write(band, 1)
    return path


def write_map(path, crs, latitude_deg, longitude_deg, pixel_m=400.0, size=81, ground_m=relief_m):
    """Smooth ground on a map, centred on a place."""
    crs = pyproj.CRS(crs)
    to_map = pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)
    x_m, y_m = to_map.transform(longitude_deg, latitude_deg)
    place = rasterio.Affine(pixel_m, 0, x_m - size * pixel_m / 2, 0, -pixel_m, y_m + size * pixel_m / 2)
    step = (np.arange(size) + 0.5) * pixel_m
    x, y = np.meshgrid(place.c + step, place.f - step)
    longitude, latitude = to_map.transform(x, y, direction="INVERSE")
    return write(path, crs.to_wkt("WKT1_GDAL"), place, ground_m(longitude, latitude))


def to_horizon(crs, latitude_deg, longitude_deg, altitude_m):
    """PROJ's transformer from longitude, latitude and altitude to east, north and up at a place."""
    a, b = body_of(crs)
    return pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +a={a} +b={b} "
        f"+step +proj=topocentric +a={a} +b={b} +lat_0={latitude_deg!r} +lon_0={longitude_deg!r} +h_0={altitude_m!r}"
    )


def terrain_of(path, **keys):
    return read_terrain(ElevationGrid(kind="grid", file=str(path), **keys))


def nodes(terrain):
    """East, north and z of every sample."""
    rows, columns = terrain.elevation_m.shape
    east = terrain.west_m + terrain.pixel_east_m * np.arange(columns)
    north = terrain.north_m - terrain.pixel_north_m * np.arange(rows)
    return *np.meshgrid(east, north), terrain.elevation_m - terrain.origin_elevation_m


def graphic_deg(crs, planetocentric_deg):
    a, b = body_of(crs)
    return float(np.degrees(np.arctan(np.tan(np.radians(planetocentric_deg)) * (a / b) ** 2)))


@pytest.mark.parametrize("name", MAPS)
def test_ground_lies_where_proj_puts_it(tmp_path, name):
    """Nodes go back through PROJ to longitude, latitude and altitude: there the smooth ground is that high."""
    crs, latitude_deg, longitude_deg = MAPS[name]
    normal_deg = graphic_deg(crs, latitude_deg)
    path = write_map(tmp_path / "a.tif", crs, normal_deg, longitude_deg)
    terrain = terrain_of(path, origin={"latitude_deg": latitude_deg, "longitude_deg": longitude_deg})
    horizon = to_horizon(crs, normal_deg, longitude_deg, terrain.origin_elevation_m)
    east, north, z = nodes(terrain)
    longitude, latitude, altitude = horizon.transform(east, north, z, direction="INVERSE")
    error_m = altitude - relief_m(longitude, latitude)
    assert np.isfinite(error_m).mean() > 0.5, "a square that is turned leaves corners empty"
    # Twice bilinear between samples 400 m apart: each time up to 400²/8 of the curvature of waves of up to 300 m
    # height and 600 radians around the body.
    bound_m = 2 * 400**2 / 8 * 300 * (400**2 + 500**2 + 600**2) / body_of(crs)[0] ** 2
    assert max(np.nanmax(np.abs(error_m)), float(terrain.placed.split()[-4])) < bound_m, "as stated, too"
    assert abs(np.nanmean(error_m)) < bound_m / 4
    # The ground falls away by 75 m at the corners on the Moon, and as much too little would be seen at once.
    flat_m = np.abs(terrain.elevation_m - relief_m(longitude, latitude))
    assert np.nanmax(flat_m) > 5 * bound_m


def test_orthographic_map_centred_on_the_site(tmp_path):
    """A map seen from far above: on it, the ground h above the sphere is nearer to the middle by R / (R + h)."""
    path = write_map(
        tmp_path / "a.tif", MAPS["orthographic"][0], 25.0, -46.0, ground_m=lambda x, _: 5000.0 + 0 * x
    )
    terrain = terrain_of(path)
    assert terrain.pixel_east_m == pytest.approx(400.0 * (1 + 5000.0 / MOON_M), rel=1e-6)
    east, north, z = nodes(terrain)
    radius_m = MOON_M + 5000.0
    np.testing.assert_allclose(z, np.sqrt(radius_m**2 - east**2 - north**2) - radius_m, rtol=0, atol=1e-4)
    ground = build_scene(Site(ground=ElevationGrid(kind="grid", file=str(path))))
    assert ground.origin_altitude_m == 5000.0


def test_equirectangular_by_closed_form(tmp_path):
    """Snyder 12-1 and 12-2: x = R cos(lat_ts) (lon - lon_0), y = R lat; a single peak keeps its place on the sphere."""
    radius_m, pixel_m, lat_ts, size = 3_394_839.8, 100.0, np.radians(18.0), 41
    x_m, y_m = radius_m * np.cos(lat_ts) * np.radians(77.5 - 180.0), radius_m * np.radians(18.4)
    band = np.zeros((size, size))
    band[5, 30] = 80.0
    place = rasterio.Affine(pixel_m, 0, x_m - (20 + 0.5) * pixel_m, 0, -pixel_m, y_m + (20 + 0.5) * pixel_m)
    terrain = terrain_of(write(tmp_path / "a.tif", MAPS["equirectangular"][0], place, band))
    east, north, _ = nodes(terrain)
    peak = np.nanargmax(terrain.elevation_m)
    lat_0 = np.radians(18.4)
    lat, lon = lat_0 + 15 * pixel_m / radius_m, 10 * pixel_m / radius_m / np.cos(lat_ts)
    expected = (
        (radius_m + 80) * np.cos(lat) * np.sin(lon),
        (radius_m + 80)
        * (np.cos(np.radians(18.4)) * np.sin(lat) - np.sin(np.radians(18.4)) * np.cos(lat) * np.cos(lon)),
    )
    found = east.flat[peak], north.flat[peak]
    assert found == pytest.approx(expected, abs=0.51 * terrain.pixel_east_m)
    assert terrain.elevation_m.flat[peak] > 60


def test_local_frame_round_trip_and_closed_forms():
    frame = LocalFrame(Ellipsoid(*MARS_M), np.radians(-40.0), np.radians(200.0), 2500.0)
    rng = np.random.default_rng(3)
    east, north, up = rng.uniform(-3e5, 3e5, (3, 200)) * np.array([[1], [1], [0.1]])
    there = frame.geodetic(east, north, up)
    np.testing.assert_allclose(frame.place_m(*there), np.stack([east, north, up], axis=-1), rtol=0, atol=1e-6)
    horizon = to_horizon(MAPS["north polar stereographic, ellipsoid"][0], -40.0, 200.0, 2500.0)
    # PROJ's own way back from the centre of the body is good to 0.2 mm at such heights.
    longitude, latitude, altitude = horizon.transform(east, north, up, direction="INVERSE")
    np.testing.assert_allclose(np.degrees(there[0]), latitude, rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.degrees(there[1]) % 360, longitude % 360, rtol=0, atol=1e-8)
    np.testing.assert_allclose(there[2], altitude, rtol=0, atol=1e-3)


# -- the whole body


def write_globe(
    path, first_longitude_deg, latitudes_deg=(-90, 90), per_degree=2, degrees=False, radius_m=MARS_M[0]
):
    """`relief_m`, slowed down, on a map of all longitudes."""
    columns, rows = 360 * per_degree, (latitudes_deg[1] - latitudes_deg[0]) * per_degree
    middle = first_longitude_deg + 180
    longitude, latitude = np.meshgrid(
        first_longitude_deg + (np.arange(columns) + 0.5) / per_degree,
        latitudes_deg[1] - (np.arange(rows) + 0.5) / per_degree,
    )
    unit = 1.0 if degrees else radius_m * np.pi / 180
    crs = f"+proj=longlat +R={radius_m}" if degrees else f"+proj=eqc +lon_0={middle} +R={radius_m}"
    west = first_longitude_deg if degrees else -180 * unit
    place = rasterio.Affine(unit / per_degree, 0, west, 0, -unit / per_degree, latitudes_deg[1] * unit)
    return write(path, crs, place, globe_m(longitude, latitude))


def globe_m(longitude_deg, latitude_deg):
    lon, lat = np.radians(longitude_deg), np.radians(latitude_deg)
    x, y, z = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    return 3000.0 * np.sin(9 * x + 1.0) * np.cos(8 * y) + 2000.0 * np.sin(7 * z)


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg"),
    [(0, 0), (0, 180), (12, 359.9), (-33, 179.9), (60, -0.1), (89.9, 10), (90, 0), (-90, 0), (-89.7, -100)],
)
@pytest.mark.parametrize(
    "globe", [{"first_longitude_deg": 0}, {"first_longitude_deg": -180, "degrees": True}]
)
def test_any_place_of_a_map_of_the_whole_body(tmp_path, globe, latitude_deg, longitude_deg):
    path = write_globe(tmp_path / "a.tif", **globe)
    terrain = terrain_of(path, origin={"latitude_deg": latitude_deg, "longitude_deg": longitude_deg})
    assert not np.isnan(terrain.elevation_m).any()
    horizon = to_horizon(
        f"+proj=longlat +R={MARS_M[0]}", latitude_deg, longitude_deg, terrain.origin_elevation_m
    )
    longitude, latitude, altitude = horizon.transform(*nodes(terrain), direction="INVERSE")
    assert np.ptp(nodes(terrain)[0]) > 6e5
    # Half a degree, waves of ten cycles a radian: 5 km of height times (0.5 deg)² / 8 times 2 x 9².
    assert np.abs(altitude - globe_m(longitude, latitude)).max() < 10


def test_half_size(tmp_path):
    path = write_globe(tmp_path / "a.tif", 0)
    origin = {"latitude_deg": 20.0, "longitude_deg": 0.0}
    east, north, _ = nodes(terrain_of(path, origin=origin, half_size_m=2e5))
    for place in (east, north):
        assert -2e5 <= place.min() < -1.6e5
        assert 1.6e5 < place.max() <= 2e5


def test_a_belt_that_does_not_reach_the_poles(tmp_path):
    path = write_globe(tmp_path / "a.tif", 0, latitudes_deg=(-60, 60))
    terrain = terrain_of(path, origin={"latitude_deg": 58.0, "longitude_deg": 0.0})
    east, north, z = nodes(terrain)
    meridian = np.abs(east) <= terrain.pixel_east_m / 2
    northmost_m = north[meridian & np.isfinite(z)].max()
    assert northmost_m == pytest.approx(MARS_M[0] * np.sin(np.radians(2.0)), abs=terrain.pixel_north_m)
    with pytest.raises(InputError, match="off the grid"):
        terrain_of(path, origin={"latitude_deg": 61.0, "longitude_deg": 0.0})


def test_units_and_orientations_of_maps_do_not_matter(tmp_path):
    """The same ground on maps in feet, in degrees, turned and upside down."""
    latitude_deg, longitude_deg, size = 40.0, 359.0, 61
    eqc = "+proj=eqc +lat_ts=40 +lon_0=0 +R=1737400"
    degree = MOON_M * np.pi / 180
    x_m, y_m = -degree * np.cos(np.radians(40.0)), 40.0 * degree
    step_m, half = 300.0, size / 2
    turned = rasterio.Affine.translation(x_m, y_m) @ rasterio.Affine.rotation(30.0)
    places = {
        "metres": (eqc, rasterio.Affine(step_m, 0, x_m - half * step_m, 0, -step_m, y_m + half * step_m)),
        "feet": (
            eqc + " +units=ft",
            rasterio.Affine(1000, 0, x_m / 0.3048 - half * 1000, 0, -1000, y_m / 0.3048 + half * 1000),
        ),
        "degrees": (
            "+proj=longlat +R=1737400",
            rasterio.Affine(0.01, 0, 359 - half * 0.01, 0, -0.01, 40 + half * 0.01),
        ),
        "upside down": (eqc, rasterio.Affine(step_m, 0, x_m - half * step_m, 0, step_m, y_m - half * step_m)),
        "turned": (eqc, turned @ rasterio.Affine(step_m, 0, -half * step_m, 0, -step_m, half * step_m)),
    }
    horizon = to_horizon("+proj=longlat +R=1737400", latitude_deg, longitude_deg, 0.0)
    for name, (crs, place) in places.items():
        column, row = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
        x = place.a * column + place.b * row + place.c
        y = place.d * column + place.e * row + place.f
        reference = pyproj.CRS(crs)
        to_map = pyproj.Transformer.from_crs(reference.geodetic_crs, reference, always_xy=True)
        longitude, latitude = to_map.transform(x, y, direction="INVERSE")
        path = write(tmp_path / "a.tif", crs, place, relief_m(longitude, latitude))
        terrain = terrain_of(path, origin={"latitude_deg": 40.0, "longitude_deg": 359.0})
        east, north, z = nodes(terrain)
        longitude, latitude, altitude = horizon.transform(
            east, north, z + terrain.origin_elevation_m, direction="INVERSE"
        )
        error_m = np.abs(altitude - relief_m(longitude, latitude))
        assert np.isfinite(error_m).sum() > 0.8 * size**2, name
        assert np.nanmax(error_m) < 3.0, name


def test_the_map_of_another_body(tmp_path):
    path = write_globe(tmp_path / "a.tif", 0)
    with pytest.raises(InputError) as caught:
        build_scene(Site(ground=ElevationGrid(kind="grid", file=str(path))))
    assert (
        "site.body.radius_m: must be within 1% of 3396190, the radius of the map's body (got 1737400.0)"
        in str(caught.value)
    )


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"origin": {"latitude_deg": 26.0, "longitude_deg": -46.0}}, "off the grid; use latitude from 24."),
        ({"origin": {"latitude_deg": -25.0, "longitude_deg": 134.0}}, "latitude -25, longitude 134"),
        ({"origin": {"map_x_m": 1e9, "map_y_m": 0.0}}, "map x 1e+09 m"),
        # The grid ends half a pixel of 400 m beyond its outermost samples, 16 km from the origin of its map.
        ({"origin": {"map_x_m": 16_201.0, "map_y_m": 0.0}}, "map x 16201 m, y 0 m, off the grid"),
        ({"origin": {"map_x_m": -16_201.0, "map_y_m": 0.0}}, "map x -16201 m, y 0 m, off the grid"),
        ({"origin": {"map_x_m": 0.0, "map_y_m": 16_201.0}}, "map x 0 m, y 16201 m, off the grid"),
        ({"origin": {"map_x_m": 0.0, "map_y_m": -16_201.0}}, "map x 0 m, y -16201 m, off the grid"),
        (
            {"half_size_m": 1e6},
            "ground.half_size_m: must be at most 868700, half of the body's radius (got 1000000.0)",
        ),
        ({"half_size_m": 10.0}, "1 x 1 samples"),
    ],
)
def test_places_that_are_refused(tmp_path, keys, expected):
    path = write_map(tmp_path / "a.tif", MAPS["orthographic"][0], 25.0, -46.0)
    with pytest.raises(InputError) as caught:
        terrain_of(path, **keys)
    assert expected in str(caught.value)

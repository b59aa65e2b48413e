"""Point clouds and pictures as ground: gridded by the mean, and placed by what the site states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binned_statistic_2d

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.model import Terrain
from lidar_emu.scene.terrain.read import read_terrain

CLOUD = np.random.default_rng(2).uniform([500.0, -40.0, 7.0], [540.0, -10.0, 9.0], (4000, 3))


def read(path: Path, **keys: object) -> Terrain:
    return read_terrain(ElevationGrid.model_validate({"kind": "grid", "file": str(path), **keys}))


def refusal(path: Path, **keys: object) -> str:
    with pytest.raises(InputError) as refused:
        read(path, **keys)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def written(folder: Path, kind: str, point: np.ndarray = CLOUD) -> Path:
    """Points in a file: text as numpy writes it, or LAS and LAZ as laspy does."""
    path = folder / f"cloud.{kind.rpartition(' ')[2]}"
    if path.suffix == ".xyz":
        separator = {"comma": ",", "tab": "\t", "head": ";"}.get(kind.split()[0], " ")
        head = "x;y;z;intensity" if kind.startswith("head") else ""
        extra = np.column_stack([point, np.ones(len(point))])
        np.savetxt(path, extra, "%.6f", separator, header=head, comments="")
        if not head:
            path.write_text(path.read_text().lstrip("\n"))
        return path
    laspy = pytest.importorskip("laspy", reason="the extra points is not installed")
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-6), np.floor(point.min(axis=0))
    file = laspy.LasData(header)
    file.x, file.y, file.z = point.T
    file.write(path)
    return path


@pytest.mark.parametrize("kind", ["blank xyz", "comma xyz", "tab xyz", "head xyz", "las", "laz"])
def test_a_cloud_is_gridded_by_its_means(tmp_path: Path, kind: str) -> None:
    terrain = read(written(tmp_path, kind), pixel_m=2.0)
    east = np.arange(500.0, 541.0, 2.0)
    north = np.arange(-40.0, -9.0, 2.0)
    edges = [np.append(nodes - 1.0, nodes[-1] + 1.0) for nodes in (north, east)]
    expected = binned_statistic_2d(CLOUD[:, 1], CLOUD[:, 0], CLOUD[:, 2], "mean", edges).statistic[::-1]
    np.testing.assert_allclose(terrain.elevation_m, expected, rtol=0, atol=2e-6)
    assert (terrain.pixel_east_m, terrain.pixel_north_m) == (2.0, 2.0)
    assert "21 x 16 samples at 2 m" in terrain.description
    assert "gridded from 4000 points" in terrain.description


def test_samples_without_points_are_missing_and_the_map_has_coordinates(tmp_path: Path) -> None:
    point = CLOUD[(CLOUD[:, 0] < 518) | (CLOUD[:, 0] > 524)]
    path = written(tmp_path, "xyz", point)
    terrain = read(path, pixel_m=1.0, origin={"map_x_m": 510.0, "map_y_m": -20.0}, elevation_offset_m=100.0)
    assert terrain.west_m == -10.0
    assert np.isnan(terrain.elevation_m[:, 19:24]).all()
    assert 107 < np.nanmin(terrain.elevation_m) < np.nanmax(terrain.elevation_m) < 109


@pytest.mark.parametrize(
    ("kind", "keys", "words"),
    [
        ("las", {}, "ground.pixel_m: missing; state the distance in metres"),
        ("las", {"pixel_m": 1e-3}, "at most 100000000 fit"),
        ("las", {"pixel_m": 1e6}, "1 x 1 samples"),
        ("las", {"pixel_m": 1.0, "band": "intensity"}, "elevation, all that a .las file holds"),
        ("las", {"pixel_m": 1.0, "half_size_m": 5.0}, "ground.half_size_m"),
        ("xyz", {"pixel_m": 1.0, "reflectance_band": "red"}, "holds elevations only"),
    ],
)
def test_keys_that_make_no_grid_are_refused(
    tmp_path: Path, kind: str, keys: dict[str, object], words: str
) -> None:
    assert words in refusal(written(tmp_path, kind), **keys)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.xyz", "", "no points"),
        ("a.xyz", "x y z\n", "no points"),
        ("a.xyz", "1 2\n3 4\n", "unreadable"),
        ("a.xyz", "1 2 3\n4 5 six\n", "six"),
        ("a.xyz", "1 2 3\n4 5 nan\n", "points that are not numbers"),
        ("a.xyz", "0 0 1\n9000 9000 2\n", "ground.pixel_m: 2 points for 9001 x 9001 samples"),
        ("a.xyz", "1 2 3\n4 1e300 3\n", "points that are not numbers"),
        ("a.las", "no cloud", "no LAS header"),
        ("a.laz", "LASF" * 100, "no LAS header, or a damaged one"),
        ("b.xyz", None, "no such file"),
    ],
)
def test_files_without_points_are_refused(tmp_path: Path, name: str, text: str | None, words: str) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    assert words in refusal(tmp_path / name, pixel_m=1.0)


@pytest.mark.parametrize("kind", ["las", "laz"])
@pytest.mark.parametrize("kept", [0.2, 0.5, 0.999])
def test_a_truncated_cloud_is_refused(tmp_path: Path, kind: str, kept: float) -> None:
    path = written(tmp_path, kind)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    assert "use an intact LAS or LAZ file" in refusal(path, pixel_m=1.0)


# Files that do not state where their samples lie


def test_a_marker_among_points_is_no_part_of_a_mean(tmp_path: Path) -> None:
    clean = read(written(tmp_path, "xyz"), pixel_m=1.0)
    marked = np.vstack([CLOUD, [[*CLOUD[10, :2], -9999.0], [*CLOUD[20, :2], -9999.0]]])
    path = written(tmp_path, "xyz", marked)
    assert "2 samples of -9999, which commonly marks missing ones" in refusal(path, pixel_m=1.0)
    np.testing.assert_array_equal(read(path, pixel_m=1.0, nodata=-9999.0).elevation_m, clean.elevation_m)


FOOT = 'PROJCS["x",UNIT["US survey foot",0.304800609601219]],VERT_CS["y",UNIT["metre",1]]'
METRE = 'PROJCS["x",GEOGCS["g",UNIT["degree",0.0174532925199433]],UNIT["metre",1]]'


def with_system(path: Path, text: str | None, keys: dict[int, int]) -> Path:
    """The same cloud with a coordinate system as text, or by GeoTIFF keys."""
    laspy = pytest.importorskip("laspy", reason="the extra points is not installed")
    from laspy.vlrs.vlr import VLR

    file = laspy.read(path)
    if text is not None:
        file.header.vlrs.append(VLR("LASF_Projection", 2112, "", text.encode() + b"\0"))
    else:
        numbers = [1, 1, 0, len(keys), *(n for key, code in keys.items() for n in (key, 0, 1, code))]
        file.header.vlrs.append(VLR("LASF_Projection", 34735, "", np.array(numbers, dtype="<u2").tobytes()))
    file.write(path)
    return path


@pytest.mark.parametrize(
    ("text", "keys", "finding"),
    [
        (FOOT, {}, "coordinates in US survey foot; convert them to metres"),
        (METRE, {}, None),
        ("", {}, None),
        (None, {4099: 9003}, "coordinates in unit 9003 of EPSG"),
        (None, {3076: 9002}, "coordinates in unit 9002 of EPSG"),
        (None, {3076: 9001, 4099: 9001, 3072: 26918}, None),
        (None, {3072: 2263}, "coordinates in US survey foot"),
        (None, {3072: 65535}, None),
    ],
)
def test_a_cloud_in_feet_is_refused(
    tmp_path: Path, text: str | None, keys: dict[int, int], finding: str | None
) -> None:
    if 3072 in keys:
        pytest.importorskip("rasterio", reason="the extra geo is not installed")
    path = with_system(written(tmp_path, "las"), text, keys)
    if finding is None:
        assert read(path, pixel_m=1.0).elevation_m.size > 100
    else:
        assert finding in refusal(path, pixel_m=1.0)


def picture(folder: Path) -> Path:
    image = pytest.importorskip("PIL.Image")
    path = folder / "hills.png"
    image.fromarray(np.arange(12, dtype=np.uint8).reshape(3, 4) * 10).save(path)
    return path


def test_a_picture_without_georeference_names_the_ways_out(tmp_path: Path) -> None:
    pytest.importorskip("rasterio", reason="the extra geo is not installed")
    path = picture(tmp_path)
    line = refusal(path)
    assert "no georeference; add a world file hills.pgw, or state ground.pixel_m" in line
    by_pixel = read(path, pixel_m=5.0, elevation_scale=0.1)
    np.testing.assert_allclose(by_pixel.elevation_m, np.arange(12).reshape(3, 4))
    assert (by_pixel.west_m, by_pixel.north_m, by_pixel.pixel_east_m) == (-7.5, 5.0, 5.0)
    assert "the file states no map coordinates" in refusal(
        path, pixel_m=5.0, origin={"map_x_m": 1.0, "map_y_m": 1.0}
    )
    (tmp_path / "hills.pgw").write_text("5\n0\n0\n-5\n1000\n2000\n")
    by_file = read(path, elevation_scale=0.1, origin={"map_x_m": 1005.0, "map_y_m": 1995.0})
    np.testing.assert_allclose(by_file.elevation_m, by_pixel.elevation_m)
    assert (by_file.west_m, by_file.north_m) == (-5.0, 5.0)
    assert "ground.pixel_m: leave it out: the file states it (got 5.0)" in refusal(path, pixel_m=5.0)


def test_an_array_without_spacing_names_the_ways_out(tmp_path: Path) -> None:
    path = tmp_path / "hills.npz"
    np.savez(path, elevation_m=np.arange(12.0).reshape(3, 4))
    line = refusal(path)
    assert "pixel_m: missing; store it in the file, or state ground.pixel_m" in line
    assert read(path, pixel_m=5.0).west_m == -7.5
    np.savez(path, elevation_m=np.arange(12.0).reshape(3, 4), pixel_m=5.0)
    assert "leave it out: the file states it" in refusal(path, pixel_m=5.0)

"""Numbers of elevation files that are no heights: refused in one line with the way out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import ElevationGrid
from lidar_emu.scene.terrain.model import Terrain, height_range
from lidar_emu.scene.terrain.read import read_terrain

rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")

ON_BODY = "+proj=ortho +lat_0=25 +lon_0=-46 +R=1737400 +units=m"
HILLS = np.random.default_rng(4).integers(-1400, -1200, (9, 7)).astype(np.float64)
"""Heights of a mare, without a pattern."""


def written(folder: Path, kind: str, heights: np.ndarray) -> Path:
    """The heights in a file that states no marker: `.npz`, GeoTIFF flat or on a body, or ESRI ASCII."""
    path = folder / f"grid.{kind.removeprefix('body.')}"
    if kind == "npz":
        np.savez(path, elevation_m=heights, pixel_m=10.0)
    elif kind == "asc":
        head = f"ncols {heights.shape[1]}\nnrows {len(heights)}\nxllcorner 0\nyllcorner 0\ncellsize 10\n"
        path.write_text(head + "\n".join(" ".join(map(str, row)) for row in heights.tolist()))
    else:
        profile = {"driver": "GTiff", "count": 1, "dtype": heights.dtype}
        profile |= {"height": len(heights), "width": heights.shape[1]}
        place = rasterio.Affine(10.0, 0, -35.0, 0, -10.0, 45.0)
        crs = ON_BODY if kind == "body.tif" else None
        with rasterio.open(path, "w", transform=place, crs=crs, **profile) as file:
            file.write(heights, 1)
    return path


def read(path: Path, **keys: object) -> Terrain:
    return read_terrain(ElevationGrid.model_validate({"kind": "grid", "file": str(path), **keys}))


def refusal(path: Path, **keys: object) -> str:
    with pytest.raises(InputError) as refused:
        read(path, **keys)
    line = str(refused.value)
    assert line.startswith(f"{path}: ")
    assert "\n" not in line
    return line


@pytest.mark.parametrize("kind", ["npz", "asc", "tif", "body.tif"])
@pytest.mark.parametrize("marker", [-32768, -32767, -9999, 32767])
def test_holes_without_a_tag_are_asked_about(tmp_path: Path, kind: str, marker: int) -> None:
    heights = HILLS.astype(np.int16)
    heights[1, 2] = heights[7, 0] = marker
    path = written(tmp_path, kind, heights)
    line = refusal(path)
    assert f"2 samples of {marker}, which commonly marks missing ones" in line
    assert f"ground.nodata: {marker} if they are missing" in line
    terrain = read(path, nodata=float(marker))
    # On the body, samples beside a hole have no cell, and the edge may fall between samples.
    assert np.isnan(terrain.elevation_m).sum() == 2 or kind == "body.tif"
    assert -1400 <= np.nanmin(terrain.elevation_m) < np.nanmax(terrain.elevation_m) <= -1200
    assert np.nanmin(read(path, nodata=1e30).elevation_m) < -1400 or marker > 0


@pytest.mark.parametrize("kind", ["npz", "asc", "tif"])
@pytest.mark.parametrize("number", [-32766, -10_000, 9999, 0, 100_000])
def test_a_number_far_from_all_heights_is_asked_about(tmp_path: Path, kind: str, number: int) -> None:
    heights = HILLS.copy()
    heights[1, 2] = heights[7, 0] = number
    path = written(tmp_path, kind, heights)
    assert f"2 samples of {number:g}, which lies " in refusal(path)
    assert f"2 samples of {number:g}, which lies " in refusal(path, elevation_offset_m=-float(number))
    assert np.isnan(read(path, nodata=float(number)).elevation_m).sum() == 2
    assert not np.isnan(read(path, nodata=1e30).elevation_m).any()


@pytest.mark.parametrize("second", [-32768, -32766])
def test_a_second_marker_beside_the_stated_one_is_asked_about(tmp_path: Path, second: int) -> None:
    heights = HILLS.copy()
    heights[1, 2], heights[7, 0] = -9999, second
    path = written(tmp_path, "tif", heights)
    assert f"1 samples of {second}, which" in refusal(path, nodata=-9999.0)


def test_a_peak_is_no_marker(tmp_path: Path) -> None:
    peak = HILLS.copy()
    peak[4, 3] = -1000.5
    read(written(tmp_path, "npz", peak))
    step = np.where(np.arange(9)[:, None] < 4, 0.0, 500.0) + np.zeros((9, 7))
    assert np.ptp(read(written(tmp_path, "npz", step)).elevation_m) == 500.0


@pytest.mark.parametrize("kind", ["npz", "asc", "tif"])
def test_heights_that_pass_through_a_marker_are_heights(tmp_path: Path, kind: str) -> None:
    trench = -10_000 + np.arange(63, dtype=np.float64).reshape(9, 7) - 1
    trench[0, 0] = -9999.0
    path = written(tmp_path, kind, trench[:, ::-1])
    np.testing.assert_array_equal(read(path).elevation_m, trench[:, ::-1])


@pytest.mark.parametrize("kind", ["npz", "asc", "tif"])
@pytest.mark.parametrize("number", [1e300, -3.4028234663852886e38, 2e8])
def test_heights_beyond_any_body_are_refused(tmp_path: Path, kind: str, number: float) -> None:
    heights = HILLS.copy()
    heights[1, 1] = number
    path = written(tmp_path, kind, heights)
    line = refusal(path)
    # GDAL reads ASCII grids in single precision.
    height_m = number if kind != "asc" else np.clip(number, *[s * 3.4028235e38 for s in (-1, 1)])
    assert f"a height of {height_m:.6g} m; state ground.nodata: " in line
    marker = float(line.split("ground.nodata: ")[1].split()[0])
    assert np.isnan(read(path, nodata=marker).elevation_m).sum() == 1


@pytest.mark.parametrize(
    ("unit", "metres"),
    [
        ("", 1.0),
        ("unspecified", 1.0),
        ("metre", 1.0),
        ("Kilometers", 1000.0),
        ("ft", 0.3048),
        ("FEET", 0.3048),
        ("US survey foot", 1200 / 3937),
        ("cm", 0.01),
    ],
)
@pytest.mark.parametrize("kind", ["tif", "body.tif"])
def test_heights_are_in_the_unit_of_their_band(tmp_path: Path, kind: str, unit: str, metres: float) -> None:
    path = written(tmp_path, kind, HILLS)
    with rasterio.open(path, "r+") as file:
        file.units = [unit]
    known = read(written(tmp_path, "npz", HILLS * metres))
    assert read(path).origin_elevation_m == pytest.approx(known.origin_elevation_m, rel=1e-6)
    assert read(path, elevation_scale=2.0).origin_elevation_m == pytest.approx(
        2.0 / metres * known.origin_elevation_m, rel=1e-6
    )


@pytest.mark.parametrize("unit", ["furlong", "degC", "m/s"])
def test_heights_in_other_units_are_refused(tmp_path: Path, unit: str) -> None:
    path = written(tmp_path, "tif", HILLS)
    with rasterio.open(path, "r+") as file:
        file.units = [unit]
    assert f"heights in '{unit}'; state ground.elevation_scale, the metres of one" in refusal(path)


@pytest.mark.parametrize(("system", "metres"), [("5703", 1.0), ("8228", 0.3048), ("6360", 1200 / 3937)])
def test_heights_are_in_the_unit_of_a_vertical_system(tmp_path: Path, system: str, metres: float) -> None:
    """GDAL reports a GeoTIFF's vertical unit as its band's; an ENVI file has it in the coordinate system only."""
    path = tmp_path / "compound.dat"
    profile = {"driver": "ENVI", "count": 1, "dtype": "float64", "height": 9, "width": 7}
    place = rasterio.Affine(10.0, 0, -35.0, 0, -10.0, 45.0)
    with rasterio.open(path, "w", transform=place, crs=f"EPSG:26918+{system}", **profile) as file:
        file.write(HILLS, 1)
    with rasterio.open(path) as file:
        assert file.units == (None,)
    here = read(path, placement="flat").origin_elevation_m
    assert here == pytest.approx(metres * read(written(tmp_path, "npz", HILLS)).origin_elevation_m, rel=1e-6)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_a_band_that_is_flat_or_upside_down_is_refused(tmp_path: Path, scale: float) -> None:
    path = written(tmp_path, "tif", HILLS)
    with rasterio.open(path, "r+") as file:
        file.scales = [scale]
    assert f"scale {scale:g} and offset 0 of its band; use a scale above 0" in refusal(path)


@pytest.mark.parametrize("name", ["virtual.vrt", "virtual.tif"])
def test_a_file_that_reads_other_files_is_refused(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    other = written(tmp_path, "tif", HILLS)
    band = (
        f'<VRTRasterBand dataType="Float64" band="1"><SimpleSource><SourceFilename>{other}</SourceFilename>'
    )
    path = tmp_path / name
    path.write_text(
        f'<VRTDataset rasterXSize="7" rasterYSize="9">{band}</SimpleSource></VRTRasterBand></VRTDataset>'
    )
    assert "not recognized as being in a supported file format" in refusal(path)
    assert capfd.readouterr().err == ""


def test_files_without_any_sample_are_refused(tmp_path: Path) -> None:
    assert "every sample is missing" in refusal(written(tmp_path, "npz", np.full((3, 3), np.nan)))
    assert "9 samples of -32768" in refusal(written(tmp_path, "npz", np.full((3, 3), -32768)))


@pytest.mark.parametrize("rows_left", [1, 5, 8])
def test_a_truncated_ascii_grid_is_refused(tmp_path: Path, rows_left: int) -> None:
    path = written(tmp_path, "asc", HILLS)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[: 5 + rows_left]) + "\n")
    assert f"{7 * rows_left} numbers for 9 rows of 7" in refusal(path)


@pytest.mark.parametrize(
    ("old", "new", "finding"),
    [
        ("-", "", None),
        (" ", "\n", None),
        ("\n-", "\r\n-", None),
        (".0 ", "x0 ", "not a number, near"),
        (".0 ", ".0.3 ", "not a number, near"),
        ("-", "--", "not a number, near"),
        (".0 ", ".0- ", "not a number, near"),
        (".0 ", ".0e+02 ", None),
        (".0 ", ".5E-1 ", None),
        (" -", " ", None),
        (".0 -", ".0-", "not a number, near"),
    ],
)
def test_only_numbers_count_in_an_ascii_grid(tmp_path: Path, old: str, new: str, finding: str | None) -> None:
    path = written(tmp_path, "asc", HILLS)
    head, body = path.read_text().split("cellsize 10\n")
    path.write_text(f"{head}cellsize 10\n{body.replace(old, new, 1)}", newline="")
    if finding is None:  # without its sign, a height is far from all others
        assert read(path, nodata=1e30).elevation_m.shape == (9, 7)
    else:
        assert finding in refusal(path)


def test_range_and_largest_step() -> None:
    grid = np.array([[1.0, 2.0, np.nan], [4.0, -8.0, 3.0], [4.5, 9.0, 30.0]])
    assert tuple(height_range(grid)) == (-8.0, 30.0, 27.0)
    low, high, step = height_range(np.array([[5.0, np.nan], [np.nan, 6.0]]))
    assert (low, high) == (5.0, 6.0)
    assert np.isnan(step)
    assert np.isnan(height_range(np.full((2, 2), np.nan))).all()
    many = np.random.default_rng(1).normal(size=(300, 200))
    steps = [np.abs(np.diff(many, axis=axis)).max() for axis in (0, 1)]
    np.testing.assert_allclose(height_range(many), (many.min(), many.max(), max(steps)), rtol=1e-15)


def test_the_heights_of_a_map_are_those_of_its_file(tmp_path: Path) -> None:
    # 400 km of level ground fall by 11 km from the plane that touches it in the middle.
    path = tmp_path / "level.tif"
    profile = {"driver": "GTiff", "count": 1, "dtype": "float64", "height": 41, "width": 41}
    place = rasterio.Affine(1e4, 0, -2.05e5, 0, -1e4, 2.05e5)
    with rasterio.open(path, "w", transform=place, crs=ON_BODY, **profile) as file:
        file.write(np.where(np.arange(41) < 20, 1000.0, 1250.0) * np.ones((41, 41)), 1)
    terrain = read(path, half_size_m=1.9e5)
    assert np.nanmin(terrain.elevation_m) < -10_000
    assert "heights 1000 to 1250 m, largest step 250 m" in terrain.description

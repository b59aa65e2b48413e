"""Hazard maps: planes, boulders and noise of known size, and how often footprints called safe are safe."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import binom, multivariate_normal, norm

from lidar_emu.cli import cli
from lidar_emu.numerics.binomial import exact_interval
from lidar_emu.report.ground_survey import GroundSurvey
from lidar_emu.report.hazard_map import (
    PLACES_M,
    HazardMap,
    Lander,
    fit_planes,
    footprint_cells,
    map_hazards,
    margin_cells,
    slope_within,
)
from lidar_emu.report.hazard_plots import draw_hazards
from lidar_emu.report.hazard_regions import (
    DetectionTally,
    TrueHazard,
    by_height,
    by_probability,
    total,
    verify,
)
from lidar_emu.report.hazards import CELL_M, Cloud, predict_heights

LANDER = Lander()
GRADIENT = np.array([np.tan(np.radians(4.0)), -np.tan(np.radians(3.0))])


def cloud_over(points_m: np.ndarray, sigma_m: float, off_m: np.ndarray | None = None) -> Cloud:
    """Points of one beam, 50 m below the vehicle; by default none is off the plane of its neighbours."""
    count = len(points_m)
    off_m = np.zeros(count) if off_m is None else off_m
    whole = dict.fromkeys(Cloud._fields, np.full(count, 50.0))
    return Cloud(**whole)._replace(
        seen_m=points_m,
        seen_sigma_m=np.full(count, sigma_m),
        seen_beam=np.zeros(count, dtype=np.int64),
        own=np.arange(count),
        off_m=off_m,
        sigma_m=np.full(count, sigma_m),
    )


def lattice(half_m: float) -> np.ndarray:
    """A point in the middle of every cell of a square."""
    axis_m = np.arange(-half_m, half_m, CELL_M) + CELL_M / 2
    east_m, north_m = (each.ravel() for each in np.meshgrid(axis_m, axis_m))
    up_m = 7.0 + GRADIENT[0] * east_m + GRADIENT[1] * north_m
    return np.column_stack([east_m, north_m, up_m])


def test_plane_has_its_slope_and_no_roughness() -> None:
    found = map_hazards(cloud_over(lattice(10.0), 1e-3), LANDER)
    known = np.isfinite(found.safe_probability)
    assert known[20, 20]
    assert not known[0, 0]  # half of the footprint of a corner has no points
    np.testing.assert_allclose(
        found.slope_deg[known], np.degrees(np.arctan(np.linalg.norm(GRADIENT))), atol=1e-9
    )
    np.testing.assert_allclose(found.roughness_m[known], 0.0, atol=1e-9)
    assert found.safe_probability[20, 20] == pytest.approx(1.0, abs=1e-6)
    assert found.safe_probability[known].min() > 0.99  # at the edge, not all of the footprint is seen
    east_m, north_m = np.meshgrid(found.east_m, found.north_m)
    np.testing.assert_allclose(found.height_m, 7.0 + GRADIENT[0] * east_m + GRADIENT[1] * north_m)
    steep = map_hazards(cloud_over(lattice(10.0), 1e-3), LANDER._replace(slope_deg=4.9))
    np.testing.assert_allclose(steep.safe_probability[known], 0.0, atol=1e-6)


@pytest.mark.parametrize(("height_m", "safe"), [(0.6, False), (0.2, True)])
def test_one_boulder_blocks_the_footprints_that_reach_it(height_m: float, safe: bool) -> None:
    points_m = lattice(15.0)
    boulder = (np.abs(points_m[:, :2] - 0.25) < 0.6).all(axis=1)
    points_m[boulder, 2] += height_m
    found = map_hazards(cloud_over(points_m, 0.01), LANDER)
    away_m = np.hypot(*np.meshgrid(found.east_m - 0.25, found.north_m - 0.25))
    known = np.isfinite(found.safe_probability)
    below, beside = known & (away_m <= 5.0), known & (away_m > 7.0)
    assert below.sum() == footprint_cells(10.0).sum()
    # The least squares plane rises below the boulder by its share of the footprint, 3 %, and tilts towards it.
    np.testing.assert_allclose(found.roughness_m[below], height_m, rtol=0.15)
    np.testing.assert_allclose(found.roughness_m[beside], 0.0, atol=1e-3)
    assert (found.safe_probability[beside] > 0.9).all()
    assert ((found.safe_probability[below] > 0.5) == safe).all()


def test_noise_of_heights_is_that_of_slopes() -> None:
    """Over n cells in a disc of radius R the slope has the standard deviation 2 σ / (R √n) on each axis."""
    rng, sigma_m = np.random.default_rng(1), 0.1
    margin, inside = margin_cells(10.0), footprint_cells(10.0)
    gradients = []
    for _ in range(300):
        noise_m = sigma_m * rng.standard_normal((2 * margin + 1,) * 2)
        (planes,) = fit_planes(
            np.repeat(noise_m[..., None], len(PLACES_M), 2), np.full_like(noise_m, sigma_m), 10.0
        )
        gradients.append(planes.gradient[0])
    stated = np.sqrt(np.diag(planes.covariance[0]))
    np.testing.assert_allclose(stated, 2 * sigma_m / (5.0 * np.sqrt(inside.sum())), rtol=0.02)
    np.testing.assert_allclose(np.std(gradients, axis=0), stated, rtol=0.15)


def test_probability_of_a_slope() -> None:
    """Rayleigh's law about zero, and scipy's Gaussian for others."""
    limit = np.tan(np.radians(10.0))
    for sigma in (0.02, 0.1, 0.5):
        found = slope_within(np.zeros((1, 2)), np.eye(2)[None] * sigma**2, 10.0)
        assert found[0] == pytest.approx(1 - np.exp(-(limit**2) / 2 / sigma**2), abs=1e-6)
    covariance = np.array([[0.004, 0.0015], [0.0015, 0.001]])
    drawn = multivariate_normal([0.12, 0.06], covariance).rvs(400_000, random_state=1)
    share = (np.hypot(*drawn.T) < limit).mean()
    assert slope_within(np.array([[0.12, 0.06]]), covariance[None], 10.0)[0] == pytest.approx(share, abs=3e-3)


def relief(rng: np.random.Generator, cells: int, cell_m: float, hurst: float) -> np.ndarray:
    """Fractal heights by their spectrum, (cells, cells), with an rms difference of 0.05 m over 1 m."""
    cycles = np.hypot(*np.meshgrid(*(np.fft.fftfreq(cells, cell_m),) * 2))
    amplitude = np.where(cycles > 0, np.maximum(cycles, 1e-9) ** -(hurst + 1), 0.0)
    up_m = np.fft.ifft2(amplitude * np.fft.fft2(rng.standard_normal((cells, cells)))).real
    lag = round(1.0 / cell_m)
    return up_m * 0.05 / np.sqrt(np.mean((up_m[lag:] - up_m[:-lag]) ** 2))


@pytest.mark.parametrize("sigma_m", [1e-3, 0.05])
def test_predicted_heights_have_the_errors_that_they_state(sigma_m: float) -> None:
    """Fractal relief, six times as rough on one half: of the places, 90 % are in the interval of 90 % on each half."""
    rng, cell_m, cells = np.random.default_rng(2), 0.125, 256
    up_m = relief(rng, cells, cell_m, 0.5)
    up_m[:, cells // 2 :] *= 6.0
    row, column = rng.integers(0, cells, (2, 9000))
    points_m = np.column_stack([cell_m * column, cell_m * row, up_m[row, column]])
    points_m[:, 2] += sigma_m * rng.standard_normal(len(points_m))
    at = rng.integers(8, cells - 8, (2, 4000))
    found = predict_heights(points_m, np.full(len(points_m), sigma_m), cell_m * at[::-1].T)
    below = (found.weight * norm.cdf((up_m[tuple(at)] - found.mean_m) / found.sigma_m)).sum(axis=0)
    for half in (at[1] < cells // 2, at[1] >= cells // 2):
        assert np.mean((below[half] > 0.05) & (below[half] < 0.95)) == pytest.approx(0.9, abs=0.09)
        error_m = (up_m[tuple(at)] - found.expected_m)[half]
        assert error_m.std() == pytest.approx(np.sqrt((found.deviation_m[half] ** 2).mean()), rel=0.3)


@pytest.mark.slow
def test_of_the_footprints_called_safe_with_p_a_share_of_p_is_safe() -> None:
    rng, lander, stated, safe = np.random.default_rng(3), Lander(4.0, 10.0, 0.3), [], []
    cells = footprint_cells(lander.footprint_m)
    beside_m = CELL_M * (np.argwhere(cells) - margin_cells(lander.footprint_m))
    places_m = (beside_m[:, None] + PLACES_M).reshape(-1, 2)
    design = np.column_stack([np.ones(len(places_m)), places_m])
    for _ in range(40):
        up_m = rng.uniform(1.0, 5.0) * relief(rng, 128, 0.125, 0.8)
        row, column = rng.integers(0, 128, (2, 1200))
        points_m = np.column_stack(
            [0.125 * column, 0.125 * row, up_m[row, column] + 0.01 * rng.standard_normal(1200)]
        )
        found = map_hazards(cloud_over(points_m, 0.01), lander)
        for row, column in np.argwhere(np.isfinite(found.safe_probability))[::5]:
            centre_m = np.array([found.east_m[column], found.north_m[row]])
            if np.abs(centre_m - 8.0).max() < 5.5:
                at = np.round((centre_m + places_m) / 0.125).astype(int)
                ground_m = up_m[at[:, 1], at[:, 0]]
                plane = np.linalg.lstsq(design, ground_m, rcond=None)[0]
                steep = np.hypot(*plane[1:]) > np.tan(np.radians(lander.slope_deg))
                safe.append(not steep and np.abs(ground_m - design @ plane).max() < lander.step_m)
                stated.append(found.safe_probability[row, column])
    stated, safe = np.array(stated), np.array(safe)
    for low, high, tolerance in ((0.0, 0.1, 0.05), (0.1, 0.9, 0.12), (0.9, 1.01, 0.03)):
        own = (stated >= low) & (stated < high)
        assert own.sum() > 50, (low, own.sum())
        assert safe[own].mean() == pytest.approx(stated[own].mean(), abs=tolerance)


def test_points_on_a_line_tell_heights_and_no_slope() -> None:
    """Points of a single beam that flies north over level ground."""
    points_m = np.column_stack([np.full(60, 0.25), np.arange(60) / 2, np.zeros(60)])
    cloud = cloud_over(points_m, 0.01)
    found = map_hazards(cloud, LANDER)
    assert found.height_m.shape == (60, 21)
    assert np.isfinite(found.height_m).sum() == 60
    assert np.isnan(found.safe_probability).all()
    tally, *truth = verify(cloud, found, Hill())  # type: ignore[arg-type]
    figure = draw_hazards(cloud, found, *truth, tally, tally, "a title")
    assert "beam 0" in [text.get_text() for text in figure.subfigs[0].axes[6].get_legend().get_texts()]


class Hill:
    """A level ground with a box of 1.5 m by 1 m, 0.5 m high, in the origin."""

    description = "a box"

    def height_m(self, east_m: np.ndarray, north_m: np.ndarray) -> np.ndarray:
        return np.where((np.abs(east_m) < 0.75) & (np.abs(north_m) < 0.5), 0.5, 0.0)


def on_hill(off_box: bool) -> tuple[Cloud, HazardMap, DetectionTally, GroundSurvey, np.ndarray]:
    points_m = lattice(10.0)
    points_m[:, 2] = 0.0 if off_box else Hill().height_m(*points_m[:, :2].T)
    cloud = cloud_over(points_m, 0.01, points_m[:, 2])
    found = map_hazards(cloud, LANDER)
    return cloud, found, *verify(cloud, found, Hill())  # type: ignore[arg-type]


def test_true_hazard_has_its_size_and_is_detected_by_a_point_that_stands_out() -> None:
    _, found, verified, *_ = on_hill(off_box=False)
    (box,) = verified.hazards
    assert (box.kind, box.touched, box.detected) == ("boulder", True, True)
    assert (box.east_m, box.north_m) == (pytest.approx(0.0), pytest.approx(0.0))
    assert box.height_m == pytest.approx(0.5, abs=0.02)
    assert (box.length_m, box.width_m) == (pytest.approx(1.5), pytest.approx(1.0))
    known = np.isfinite(found.safe_probability)
    away_m = np.hypot(*np.meshgrid(found.east_m, found.north_m))[known]
    assert verified.alarms == 0
    assert not verified.safe[away_m < 4.0].any()
    assert verified.safe[away_m > 6.0].all()
    _, _, unseen, *_ = on_hill(off_box=True)
    assert (unseen.hazards[0].touched, unseen.hazards[0].detected) == (True, False)


def test_tip_between_the_points_makes_its_landing_areas_unsafe() -> None:
    """A tip as narrow as a sample of a grid, on a corner of cells; the points are in their middles."""

    class Tip(Hill):
        def height_m(self, east_m: np.ndarray, north_m: np.ndarray) -> np.ndarray:
            return 0.5 * ((np.abs(east_m) < 0.01) & (np.abs(north_m) < 0.01))

    points_m = lattice(10.0) * [1.0, 1.0, 0.0]
    cloud = cloud_over(points_m, 0.01)
    found = map_hazards(cloud, LANDER)
    tally, *_ = verify(cloud, found, Tip())  # type: ignore[arg-type]
    known = np.isfinite(found.safe_probability)
    away_m = np.hypot(*np.meshgrid(found.east_m, found.north_m))[known]
    assert not tally.safe[away_m < 4.5].any()
    assert tally.safe[away_m > 5.5].all()


def test_landing_areas_are_counted_by_their_safe_probability() -> None:
    probability, safe = np.array([0.0, 0.01, 0.35, 0.45, 1.0]), np.array([False, False, True, False, True])
    rows = by_probability(DetectionTally([], 0, 0, probability, safe))
    assert [(row.landing_areas, row.safe) for row in rows] == [(2, 0.0), (2, 0.5), (1, 1.0)]
    assert [row.stated for row in rows] == pytest.approx([0.005, 0.4, 1.0])


def test_point_that_stands_out_of_level_ground_is_a_false_alarm() -> None:
    points_m = lattice(10.0)
    points_m[:, 2] = 0.0
    off_m = np.zeros(len(points_m))
    off_m[[3, 5]] = 0.5
    cloud = cloud_over(points_m, 0.01, off_m)
    verified, *_ = verify(cloud, map_hazards(cloud, LANDER), Hill())  # type: ignore[arg-type]
    assert verified.alarms == 2
    assert verified.level < len(points_m) == 1600


def test_hazards_are_counted_by_height_with_exact_intervals() -> None:
    def hazard(height_m: float, detected: bool) -> TrueHazard:
        return TrueHazard(0.0, 0.0, height_m, 1.0, 1.0, 0.0, True, detected)

    rows = by_height([hazard(0.16, False), hazard(0.4, True), hazard(-0.35, False)], 0.3)
    assert [(row.hazards, row.detected) for row in rows] == [(1, 0), (0, 0), (2, 1)]
    assert rows[2].low_m == pytest.approx(0.3)
    assert exact_interval(0, 0, 0.025) == (0.0, 1.0)
    low, high = exact_interval(3, 20, 0.025)
    assert binom.sf(2, 20, low) == pytest.approx(0.025)
    assert binom.cdf(3, 20, high) == pytest.approx(0.025)


def test_figure_shows_each_hazard_point_and_footprint() -> None:
    cloud, found, flown, *truth = on_hill(off_box=False)
    figure = draw_hazards(cloud, found, *truth, flown, total([flown, flown]), "a title")
    above, between, below = figure.subfigs
    ground, safe, _, _, points = above.axes[:5]
    (names,), reliability = between.legends, below.axes[1]
    (on_map,), (on_points, _) = ground.patches, points.patches
    assert (on_map.width, on_map.height) == (on_points.width, on_points.height) == (1.5, 1.0)
    in_legend = names.findobj(type(on_map))[0]
    assert (in_legend.get_edgecolor(), in_legend.get_linestyle()) == (
        on_map.get_edgecolor(),
        on_map.get_linestyle(),
    )
    assert len(points.lines[0].get_xdata()) == len(cloud.seen_m)
    np.testing.assert_array_equal(safe.images[0].get_array().filled(np.nan), found.safe_probability)
    assert "boulder, rim, detected (1)" in [text.get_text() for text in names.get_texts()]
    numbers = [int(text.get_text()) for text in reliability.texts]
    assert sum(numbers) == 2 * np.isfinite(found.safe_probability).sum()


SCENE = (
    "hazards", "hazard_scan", "--set", "site=flat", "--set", "timing.rate_hz=200", "--set", "scanner.scan.steps=40",
    "--set", "trajectory.waypoints=[{altitude_m: 103, speed_mps: 10}, {altitude_m: 101, speed_mps: 10}]",
)  # fmt: skip


def run(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(cli, arguments)
    return done.exit_code, done.stdout, done.stderr


@pytest.mark.slow
def test_command_writes_maps_that_others_read(tmp_path) -> None:
    import rasterio

    for name in ("map.tif", "map.npz"):
        assert run(*SCENE, "--map", str(tmp_path / name), "--lander", "6,15,0.5")[0] == 0
    with np.load(tmp_path / "map.npz") as file:
        arrays = dict(file)
    assert [arrays[f"lander_{name}"] for name in Lander._fields] == [6.0, 15.0, 0.5]
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.descriptions == ("height_m", "slope_deg", "roughness_m", "safe_probability")
        assert file.tags()["lander_step_m"] == "0.5"
        for number, band in enumerate(file.descriptions, start=1):
            np.testing.assert_array_equal(file.read(number)[::-1], arrays[band].astype(np.float32))
        assert file.xy(0, 0) == pytest.approx((arrays["east_m"][0], arrays["north_m"][-1]))
    assert np.isfinite(arrays["safe_probability"]).sum() > 100


@pytest.mark.slow
@pytest.mark.parametrize("name", ["map.png", "map.svg", "map.pdf"])
def test_command_plots_and_counts_flights(tmp_path, name: str) -> None:
    code, printed, _ = run(*SCENE, "--plot", str(tmp_path / name), "--flights", "2", "--json")
    assert code == 0
    assert (tmp_path / name).stat().st_size > 10_000
    counted = json.loads(printed)
    assert counted["detection"] == []  # a flat ground has no hazards
    assert {row["safe"] for row in counted["reliability"]} == {1.0}
    alarms = counted["false_alarms"]
    assert alarms["alarms"] == 0
    assert alarms["interval"] == [0.0, pytest.approx(1 - 0.025 ** (1 / alarms["points"]))]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--lander", "10,10"), "--lander: must be DIAMETER,SLOPE,STEP"),
        (("--lander=-1,10,0.3",), "--lander: must be DIAMETER,SLOPE,STEP"),
        (("--lander", "10,10,nan"), "--lander: must be DIAMETER,SLOPE,STEP"),
        (("--flights", "0"), "--flights: must be a whole number above 0"),
        (("--map", "map.asc"), "use .tif, .npz"),
        (("--map", "missing/map.npz"), "no such folder"),
    ],
)
def test_input_that_cannot_be_used_is_one_line(arguments: tuple[str, ...], words: str) -> None:
    done = CliRunner().invoke(cli, ["hazards", "hazards", *arguments])
    assert words in str(done.exception)
    assert type(done.exception).__name__ == "InputError"

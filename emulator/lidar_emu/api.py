"""Simulation, campaigns, ground queries, plans and spectra from Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_extra, path_argument
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.plan import Plan
from lidar_emu.runtime.clock import Clock
from lidar_emu.scenario.load import ScenarioSource, load, require_flight, require_known_flight
from lidar_emu.scenario.parts import changed_keys
from lidar_emu.shots.model import Progress, build_model, measure_whole, state_before

if TYPE_CHECKING:
    import pyarrow as pa

    from lidar_emu.campaign.sensitivity import FactorIndices
    from lidar_emu.campaign.statistics import BandStatistics, CampaignCounts
    from lidar_emu.plan.detection_forecast import DetectionForecast
    from lidar_emu.receiver.custom_detection import Detector, SegmentSpectrum
    from lidar_emu.scenario.campaign import Campaign


def simulate(
    scenario: ScenarioSource,
    overrides: Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    detector: Detector | None = None,
    geometry: str | PathLike[str] | None = None,
    progress: Progress | None = None,
    **keys: Any,
) -> Measurement:
    """Measure a whole scenario without clock and link.

    At level reference, how long it will take is logged after the second shot and again every ten seconds, unless
    `progress` is given.

    Args:
        scenario: path of a YAML file, name of a shipped scenario, mapping with the keys of a file, or a scenario.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`.
        keys: the same for keys without a dot, e.g. `duration_s=5`.
        seed: replaces the scenario's seed; None: keep it.
        detector: finds the targets of each spectrum instead of the instrument's detector, at level spectral or
            reference: takes a `SegmentSpectrum` and returns frequencies in Hz, strongest first. None: the
            instrument's.
        geometry: file of `record_geometry` that holds this flight; None: the beams are pointed and cast.
        progress: called with the number of shots measured and of all, every 128 shots; every shot at level reference.

    Returns:
        Arrays shaped (shots, beams), with the values that a run sends for the same seed.

    Raises:
        InputError: a key or a file cannot be used, the flight leaves the ground or is not the recorded one, or its
            truth is live.
    """
    if seed is not None:
        keys["seed"] = seed
    known = load(scenario, overrides, **keys)
    require_known_flight(known)
    recorded = None if geometry is None else path_argument("simulate", "geometry", geometry)
    return measure_whole(build_model(known, recorded, detector), Clock().now_ns, progress)


def record_geometry(
    scenario: ScenarioSource,
    path: str | PathLike[str],
    overrides: Mapping[str, Any] | None = None,
    *,
    progress: Progress | None = None,
    **keys: Any,
) -> None:
    """Record where the beams of a flight point and what they hit, for `simulate(..., geometry=path)`.

    Args:
        scenario: path of a YAML file, name of a shipped scenario, mapping with the keys of a file, or a scenario.
        path: the `.npz` file to write.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`.
        progress: called with the number of shots recorded and of all, every 1024 shots.
        keys: the same as `overrides` for keys without a dot, e.g. `duration_s=5`.

    Raises:
        InputError: a key or a file cannot be used, the scenario is a bench pattern, or its truth is live.
        RunError: writing failed.
    """
    from lidar_emu.report import geometry_export

    flown = require_flight(load(scenario, overrides, **keys))
    geometry_export.record_geometry(flown, path_argument("record_geometry", "path", path), progress)


@dataclass(frozen=True)
class CampaignResults:
    """The results of a campaign, in the tables of its folder."""

    folder: Path
    runs: int
    """Runs, including failed ones."""
    failed: int
    """Failed runs of this call; the column `failed` of the table `runs` has the reasons of all."""
    _counts: CampaignCounts = field(repr=False, compare=False)
    _campaign: Campaign = field(repr=False, compare=False)

    def table(self, name: Literal["runs", "beams"], columns: list[str] | None = None) -> pa.Table:
        """Read a table: `runs` has a row per run, `beams` a row per run, shot and beam (docs/columns.md).

        Args:
            name: name of the table.
            columns: names of the columns to read; None: all.
        """
        import pyarrow.dataset as dataset

        return dataset.dataset(self.folder / name).to_table(columns=columns)

    def statistics(self) -> list[BandStatistics]:
        """Dropouts and errors by altitude and incidence, with their confidence."""
        return self._counts.statistics()

    def sensitivity(self, columns: Sequence[str] = ()) -> list[FactorIndices]:
        """Sobol indices of a campaign of sampling `saltelli`: the share of each drawn key in the variance of dropouts,
        errors and `columns`, for the whole flight and by altitude.

        Args:
            columns: further columns of the tables (docs/columns.md).

        Raises:
            InputError: the campaign has another sampling, or its tables have no such column.
        """
        from lidar_emu.campaign.sensitivity import check_columns, sensitivity_indices

        if self._campaign.sampling != "saltelli":
            raise InputError("sensitivity", "sampling", self._campaign.sampling, "must be 'saltelli'")
        check_columns("sensitivity", self._campaign, columns)
        return sensitivity_indices(self.folder, self._campaign, columns)


def run_campaign(
    campaign: str | PathLike[str] | Mapping[str, Any],
    folder: str | PathLike[str],
    overrides: Mapping[str, Any] | None = None,
    *,
    runs: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> CampaignResults:
    """Fly a campaign on this machine, or the runs of it that `folder` does not hold yet.

    A script that calls this needs `if __name__ == "__main__":`, since each worker imports it.

    Args:
        campaign: path of its YAML file; the name of a shipped campaign; or a mapping with the keys of a file, whose
            scenario is a shipped one's name or a path relative to the working directory.
        folder: folder of the results.
        overrides: dotted keys and values that all runs have instead of the scenario's.
        runs: number of runs; None: the campaign's.
        workers: number of processes; None: one per core.
        progress: called with the number of runs stored and of all, at the start and after each batch of runs.

    Raises:
        InputError: the campaign, its scenario or the folder cannot be used, or pyarrow is not installed.
        RunError: a file could not be written, or too many workers died in a row.
    """
    # Here, so that `simulate` does not load recordings and links.
    from lidar_emu.campaign.description import prepare
    from lidar_emu.campaign.run import LocalPool, compile_kernels, fly_campaign
    from lidar_emu.numerics.compilation import usable_cores

    check_extra("run_campaign", "tables", "pyarrow", "tables")
    results = path_argument("run_campaign", "folder", folder)
    for name, count in (("runs", runs), ("workers", workers)):
        if count is not None and (isinstance(count, bool) or not isinstance(count, int) or count < 1):
            raise InputError("run_campaign", name, count, "must be a whole number above 0")
    if not isinstance(campaign, str | PathLike | Mapping):
        remedy = "must be a path, the name of a shipped campaign, or a mapping"
        raise InputError("run_campaign", "campaign", campaign, remedy)
    stated = campaign if isinstance(campaign, Mapping) else Path(campaign)
    prepared = prepare(stated, changed_keys(overrides, {}), runs)
    slots = usable_cores() if workers is None else workers
    tell = progress or (lambda _done, _runs: None)
    with closing(LocalPool(min(slots, prepared.campaign.runs))) as pool:
        beams = compile_kernels(prepared, pool)
        whole, counts = fly_campaign(
            prepared, beams, results, pool, lambda flown: tell(flown.done, flown.runs)
        )
    return CampaignResults(results, whole.runs, whole.failed, counts, prepared.campaign)


class RayHits(NamedTuple):
    """First hits of rays, in the shape (...) of the rays; NaN where a ray hits nothing."""

    range_m: FloatArray
    """(...) Distance along the ray."""
    point_site_m: FloatArray
    """(..., 3) Hit point: east, north, up."""
    normal_site: FloatArray
    """(..., 3) Unit normal, pointing out of the ground."""
    incidence_deg: FloatArray
    """(...) Angle between the ray and the ground's normal."""
    reflectance: FloatArray
    """(...) Albedo."""
    object: NDArray[np.int16]
    """(...) What is hit: 0 the ground, 1, 2, ... the site's objects in order, -1 nothing."""
    inside: BoolArray
    """(...) Whether the ray starts below the surface; it then hits nothing."""


class Ground:
    """The ground of a scenario's site with its objects, in the site frame: east, north, up in metres.

    Args:
        scenario: path of a YAML file, name of a shipped scenario, mapping with the keys of a file, or a scenario.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`.
        keys: the same for keys without a dot, e.g. `duration_s=5`.

    Raises:
        InputError: the scenario or a file of its site cannot be used, or it is a bench pattern.
    """

    def __init__(
        self, scenario: ScenarioSource, overrides: Mapping[str, Any] | None = None, **keys: Any
    ) -> None:
        from lidar_emu.scene import build_scene

        self.site = require_flight(load(scenario, overrides, **keys)).site
        """The site."""
        self._scene = build_scene(self.site)

    @property
    def description(self) -> str:
        """One line on the ground."""
        return self._scene.description

    @property
    def origin_altitude_m(self) -> float:
        """Altitude of the site frame's origin above the body's sphere."""
        return self._scene.origin_altitude_m

    def height_m(self, east_m: ArrayLike, north_m: ArrayLike) -> FloatArray:
        """Height of the ground straight above or below points, without objects; NaN where there is none.

        Args:
            east_m: coordinates of the points.
            north_m: coordinates of the points, broadcast against `east_m`.

        Raises:
            InputError: the arguments are not numbers of compatible shapes.
        """
        east, north = _broadcast("height_m", east_m=east_m, north_m=north_m)
        heights = self._scene.height_m(
            np.ascontiguousarray(east).ravel(), np.ascontiguousarray(north).ravel()
        )
        return heights.reshape(east.shape)

    def cast(self, origin_site_m: ArrayLike, direction_site: ArrayLike, time_s: float = 0.0) -> RayHits:
        """First hits of rays with the ground and its objects.

        Args:
            origin_site_m: (..., 3) starting points.
            direction_site: (..., 3) directions of any length but 0; both are broadcast against each other.
            time_s: scenario time, which matters where objects move.

        Raises:
            InputError: the arguments are not finite numbers of compatible shapes (..., 3), or a direction is 0.
        """
        from lidar_emu.scene.ray_hits import MovingScene

        origin, direction = _broadcast("cast", origin_site_m=origin_site_m, direction_site=direction_site)
        if origin.ndim == 0 or origin.shape[-1] != 3:
            raise InputError("cast", None, Finding(f"shape {origin.shape}"), "pass arrays of shape (..., 3)")
        shape = origin.shape[:-1]
        starts = np.ascontiguousarray(origin, dtype=np.float64).reshape(-1, 3)
        rays = direction.reshape(-1, 3)
        largest = np.abs(rays).max(axis=-1, keepdims=True)
        if not (np.isfinite(starts).all() and np.isfinite(rays).all() and (largest > 0.0).all()):
            raise InputError("cast", None, Finding("NaN, infinity or a direction of 0"), "pass finite rays")
        # By the largest component first, whose square may be beyond floating point.
        rays = rays / largest
        rays = np.ascontiguousarray(rays / np.sqrt((rays**2).sum(axis=-1, keepdims=True)))
        if isinstance(self._scene, MovingScene):
            hits = self._scene.cast_at(np.array([round(time_s * 1e9)]), starts, rays)
        else:
            hits = self._scene.cast(starts, rays)
        cosine = np.clip(-(hits.normal_site * rays).sum(axis=-1), -1.0, 1.0)
        return RayHits(
            hits.range_m.reshape(shape),
            (starts + hits.range_m[:, None] * rays).reshape(*shape, 3),
            hits.normal_site.reshape(*shape, 3),
            np.degrees(np.arccos(cosine)).reshape(shape),
            hits.reflectance.reshape(shape),
            hits.object_id.reshape(shape),
            hits.inside.reshape(shape),
        )


def _broadcast(where: str, **arguments: ArrayLike) -> tuple[FloatArray, FloatArray]:
    arrays = []
    for key, value in arguments.items():
        try:
            arrays.append(np.asarray(value, dtype=np.float64))
        except (TypeError, ValueError):
            raise InputError(where, key, value, "must be numbers") from None
    try:
        first, second = np.broadcast_arrays(*arrays)
    except ValueError:
        found = Finding(" and ".join(f"shape {array.shape}" for array in arrays))
        raise InputError(where, None, found, "pass compatible shapes") from None
    return first, second


def plan_run(scenario: ScenarioSource, overrides: Mapping[str, Any] | None = None, **keys: Any) -> Plan:
    """Plan a run: the stages that it computes and leaves out, each with its reason and a bound of the error.

    Args:
        scenario: path of a YAML file, name of a shipped scenario, mapping with the keys of a file, or a scenario.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`.
        keys: the same for keys without a dot, e.g. `duration_s=5`.

    Raises:
        InputError: a key or a file cannot be used, or the flight leaves the ground.
    """
    return build_model(load(scenario, overrides, **keys)).plan


def detection_by_altitude(
    scenario: ScenarioSource,
    altitude_m: ArrayLike,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> DetectionForecast:
    """Forecast the detection by an instrument that hovers upright over a level plane of its site's surface.

    Args:
        scenario: path of a YAML file, name of a shipped scenario, mapping with the keys of a file, or a scenario.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`.
        keys: the same for keys without a dot, e.g. `duration_s=5`.
        altitude_m: (altitudes,) heights of the sensor above the plane.

    Raises:
        InputError: a key cannot be used, an altitude is no positive number, or the scenario is a bench pattern.
    """
    from lidar_emu.plan.detection_forecast import forecast_detection

    flown = require_flight(load(scenario, overrides, **keys))
    try:
        altitudes = np.atleast_1d(np.asarray(altitude_m, dtype=np.float64))
    except (TypeError, ValueError):
        altitudes = np.array([np.nan])
    if altitudes.ndim != 1 or not altitudes.size or not np.all((altitudes > 0.0) & np.isfinite(altitudes)):
        remedy = "must be positive numbers, (altitudes,)"
        raise InputError("detection_by_altitude", "altitude_m", altitude_m, remedy)
    return forecast_detection(flown, altitudes)


def shot_spectra(
    scenario: ScenarioSource,
    shot: int,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> dict[int, dict[str, SegmentSpectrum]]:
    """Compute the spectra of one shot, the same from which `simulate` takes its measurement.

    Level reference gives all bins, and with `reference_samples: full_rate` the samples too; level spectral gives the
    bins around the tones, without noise peaks outside them.

    Args:
        scenario: path of a YAML file, name of a shipped scenario, mapping with the keys of a file, or a scenario;
            samples need `level="reference", reference_samples="full_rate"`.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`.
        keys: the same for keys without a dot, e.g. `duration_s=5`.
        shot: number of the shot.

    Returns:
        Spectra by number of the beam and by segment: `up`, `constant`, `down`. A beam that is not measured, because it
        does not fire or touches the ground, is left out.

    Raises:
        InputError: a key or a file cannot be used, there is no such shot, or the level has no spectra.
    """
    known = load(scenario, overrides, **keys)
    require_known_flight(known)
    from lidar_emu.receiver.custom_detection import SEGMENTS

    found: dict[int, dict[str, SegmentSpectrum]] = {}

    def keep(spectrum: SegmentSpectrum) -> list[float]:
        found.setdefault(spectrum.beam, dict.fromkeys(SEGMENTS, spectrum))[spectrum.segment] = spectrum
        return []

    model = build_model(known, detector=keep)
    if isinstance(shot, bool) or not isinstance(shot, int) or not 0 <= shot < model.shot_count:
        remedy = f"must be a whole number from 0 to {model.shot_count - 1}"
        raise InputError("shot_spectra", "shot", shot, remedy)
    model.measure(shot, 1, state_before(model, shot))
    return found

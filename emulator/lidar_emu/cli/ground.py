"""`lidar-emu ground`: survey any ground; generate, compare and export a generated one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lidar_emu.cli.options import check_plot, load_scenario, plot_option, scenario_argument, settings_option
from lidar_emu.cli.terminal import print_line
from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.files import check_extra

if TYPE_CHECKING:
    from lidar_emu.numerics.arrays import FloatArray
    from lidar_emu.scenario.ground import Generated
    from lidar_emu.scenario.schema import FlightScenario
    from lidar_emu.scene.mesh.ground import TriangleMesh
    from lidar_emu.scene.procedural.compare import StatisticCheck


@click.command(short_help="Survey a ground: heights, slopes, footprint of the flight.")
@scenario_argument
@settings_option
@plot_option("shaded relief, slope and the footprint of the flight")
@plot_option("a generated ground and its statistics", "--statistics")
@click.option(
    "--out", metavar="FILE", help="A generated ground as .npz, .tif (GeoTIFF) or .asc (ESRI ASCII grid)."
)
@click.option(
    "--compare", metavar="embreex", help="Cast rays at the meshes by lidar-emu and by Embree, and compare."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def ground(
    scenario: str,
    settings: tuple[str, ...],
    plot: tuple[str, ...],
    statistics: tuple[str, ...],
    out: str | None,
    compare: str | None,
    as_json: bool,
) -> None:
    """Survey the ground of SCENARIO's site, of any kind, and compare a generated one with what it specifies.

    A generated ground is cached for later runs. An exported file can be used as `ground: {kind: grid, file: FILE}`, and
    by other tools. With --compare, SCENARIO may be the file of a mesh.

    \b
    lidar-emu ground descent.yaml --plot ground.png
    lidar-emu ground descent.yaml --set site=cratered --statistics statistics.png
    lidar-emu ground descent.yaml --set site=cratered --set site.ground.seed=7 --out seed7.tif
    lidar-emu ground my.yaml --json
    lidar-emu ground my.obj --compare embreex
    """
    if compare is not None:
        if compare != "embreex":
            raise InputError("--compare", None, compare, "must be embreex")
        if plot or statistics or out:
            remedy = "leave out --plot, --statistics and --out"
            raise InputError("--compare", None, Finding("writes no file"), remedy)
        _compare_casting(scenario, settings, as_json)
        return
    from lidar_emu.report.ground_survey import GROUND_SUFFIXES, check_raster_path, survey_ground
    from lidar_emu.scenario.load import check_keeps_files, require_flight

    for path in set(plot).intersection(statistics):
        raise InputError("--statistics", None, path, "must be another file than that of --plot")
    check_plot((*plot, *statistics))
    if out is not None:
        check_raster_path(Path(out), GROUND_SUFFIXES)
    flown = require_flight(load_scenario(scenario, None, None, settings))
    check_keeps_files(flown, {"--out": [out], "--plot": plot, "--statistics": statistics})
    specified = _generated(scenario, flown, {"--statistics": statistics, "--out": out})
    document: dict[str, Any] = {"ground": flown.site.ground.model_dump()}
    comparison = None
    if specified is not None:
        comparison, more = _compared(specified, flown.site.name, statistics, out)
        document |= more
    survey, below = survey_ground(flown)
    document["survey"] = survey.to_json()
    for path in plot:
        from lidar_emu.report.ground_plots import plot_survey

        title = f"{flown.name.replace('_', ' ')}: ground of {flown.site.name}"
        plot_survey(survey, below, title, Path(path))
    if as_json:
        print_line(json.dumps(document, indent=2))
        return
    if specified is not None and comparison is not None:
        _print_comparison(specified, comparison, document["whole_ground"])
    _print_survey(document["survey"])
    for path in filter(None, (out, *statistics, *plot)):
        print_line(path)


def _compare_casting(name: str, settings: tuple[str, ...], as_json: bool) -> None:
    """Compare the casting onto a mesh file, or onto the meshes of a scenario, and print the figures.

    Raises:
        InputError: an argument cannot be used, or there is no mesh.
        RunError: rounding does not explain a difference.
    """
    check_extra("--compare", "a comparison", "embreex", "mesh")
    from lidar_emu.numerics.random_streams import COMPARED_RAYS, generator
    from lidar_emu.report.casting_comparison import compare_casting

    meshes = _meshes(name, settings)
    found = {what: compare_casting(mesh, generator(1, COMPARED_RAYS)) for what, mesh in meshes.items()}
    if as_json:
        print_line(json.dumps(found, indent=2))
    for what, one in found.items() if not as_json else ():
        print_line(what)
        for key, value in one.items():
            print_line(f"  {key}: {json.dumps(value)}")
    if unexplained := sum(one["unexplained"] for one in found.values()):
        raise RunError(f"{name}: {unexplained} rays differ by more than float32 explains")


def _meshes(name: str, settings: tuple[str, ...]) -> dict[str, TriangleMesh]:
    from lidar_emu.report.casting_comparison import meshes_of
    from lidar_emu.scenario.load import require_flight
    from lidar_emu.scene import build_scene
    from lidar_emu.scene.mesh.file import SUFFIXES, read_mesh
    from lidar_emu.scene.mesh.ground import TriangleMesh, Triangles

    if (suffix := Path(name).suffix.lower()) in SUFFIXES and not settings:
        file = read_mesh(name, "km" if suffix in (".bds", ".dsk") else "m")
        sheet = not (file.is_closed and file.faces_one_way)
        return {file.description: TriangleMesh(Triangles.alike(file.corner_m, 1.0, sheet))}
    meshes = meshes_of(build_scene(require_flight(load_scenario(name, None, None, settings)).site))
    if not meshes:
        remedy = "name a site with a mesh or objects, or the file of a mesh"
        raise InputError(name, "site", Finding("no triangles"), remedy)
    return meshes


def _compared(
    specified: Generated, site: str, statistics: tuple[str, ...], out: str | None
) -> tuple[list[StatisticCheck], dict[str, Any]]:
    """Generate a ground, export and plot it, and compare it with what it specifies: rows, and keys of the document."""
    import numpy as np

    from lidar_emu.scene.procedural.compare import compare
    from lidar_emu.scene.procedural.generate import generate, store

    layers = generate(specified)
    elevation_m = layers.elevation_m(specified)
    stored = store(specified, elevation_m)
    found = compare(specified, layers)
    if out is not None:
        from lidar_emu.report.ground_survey import export_ground

        export_ground(specified, elevation_m, Path(out))
    for path in statistics:
        from lidar_emu.report.ground_plots import plot_ground

        plot_ground(specified, layers, found, f"{site}: {_title(specified)}", Path(path))
    return found, {
        "kept_in": None if stored is None else str(stored),
        "whole_ground": _whole(specified, elevation_m.astype(np.float64)),
        "statistics": [{**vars(row), "within": row.within} for row in found],
    }


def _generated(scenario: str, flown: FlightScenario, options: dict[str, object]) -> Generated | None:
    """The generated ground of a site; None for one of another kind, which has none of these options."""
    from lidar_emu.scenario.ground import Generated

    if isinstance(flown.site.ground, Generated):
        return flown.site.ground
    for option, value in options.items():
        if value:
            found = Finding(f"a ground of kind {flown.site.ground.kind}")
            raise InputError(scenario, "site.ground.kind", found, f"{option} needs a generated ground")
    return None


def _print_survey(survey: dict[str, Any]) -> None:
    east_m, north_m = survey["sampled_every_m"]
    print_line(survey["description"])
    print_line(f"area: {_area_in_words(survey['area_m'])}")
    if survey["lowest_m"] is not None:
        low_m, high_m = (round(survey[key], 1) + 0.0 for key in ("lowest_m", "highest_m"))  # never minus zero
        print_line(
            f"heights above the origin: {low_m} to {high_m} m, sampled every {east_m:.3g} m x {north_m:.3g} m"
        )
    if survey["missing_share"]:
        print_line(f"without ground: {survey['missing_share']:.2%} of the area")
    print_line(f"slope over {2 * east_m:.3g} m: {_percentiles_in_words(survey['slope_deg'])}")
    footprint = survey["footprint"]
    if footprint is None:
        print_line("footprint: the flight is not known before the run")
        return
    print_line(f"footprint of the flight: {_area_in_words(footprint['area_m'])}")
    print_line(f"incidence of the beams: {_percentiles_in_words(footprint['incidence_deg'])}")
    print_line(f"beams without ground: {footprint['no_ground_share']:.2%}")


def _area_in_words(area_m: dict[str, float]) -> str:
    west, east, south, north = area_m.values()
    return (
        f"{east - west:.1f} m x {north - south:.1f} m, "
        f"east {west:.1f} to {east:.1f} m, north {south:.1f} to {north:.1f} m"
    )


def _percentiles_in_words(degrees: dict[str, float] | None) -> str:
    if degrees is None:
        return "unknown"
    return f"median {degrees['median']:.1f}°, 95th percentile {degrees['p95']:.1f}°, largest {degrees['largest']:.1f}°"


def _title(specified: Generated) -> str:
    return f"generated ground, {specified.size_m:g} m, a sample every {specified.spacing_m:g} m, seed {specified.seed}"


def _whole(specified: Generated, elevation_m: FloatArray) -> dict[str, Any]:
    """Height range and slopes of the whole ground, to which relief, craters and rocks all contribute."""
    import numpy as np

    from lidar_emu.scene.procedural.generate import doubling_lags, structure_function

    lags = doubling_lags(len(elevation_m), 1 / 8)
    distance_m = lags * specified.spacing_m
    slope_deg = np.degrees(np.arctan(np.sqrt(structure_function(elevation_m, lags)) / distance_m))
    return {
        "lowest_m": float(elevation_m.min()),
        "highest_m": float(elevation_m.max()),
        "rms_slope": [
            {"baseline_m": baseline_m, "slope_deg": slope}
            for baseline_m, slope in zip(distance_m.tolist(), slope_deg.tolist(), strict=True)
        ],
    }


def _print_comparison(specified: Generated, found: list[StatisticCheck], whole: dict[str, Any]) -> None:
    from lidar_emu.cli.plain_console import PlainConsole, plain_table

    headings = "statistic", "requested", "found", "from", "to"
    table = plain_table(*headings, title=_title(specified), texts=1)
    table.add_column("")
    for row in found:
        numbers = (f"{value:.4g}" for value in (row.asked, row.found, row.low, row.high))
        table.add_row(row.quantity, *numbers, "" if row.within else "outside")
    console = PlainConsole()
    console.print(table)
    slopes = ", ".join(f"{row['slope_deg']:.3g}° over {row['baseline_m']:g} m" for row in whole["rms_slope"])
    console.print(
        f"The whole ground lies between {whole['lowest_m']:.1f} and {whole['highest_m']:.1f} m; rms slope {slopes}."
    )

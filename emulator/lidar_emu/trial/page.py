"""The page of a trial: for each case its verdicts, the errors beside the stated sigmas, and the trust in each beam."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.html_parts import figure_element, heading, html_table, note, page_document
from lidar_emu.report.plot_style import GRID, INK, Drawing, draw_figure, write_drawing
from lidar_emu.trial.fly import Flown
from lidar_emu.trial.grading import Deception, Grade, TrueMotion
from lidar_emu.trial.judge import CaseVerdict, cells, described, lines_of
from lidar_emu.trial.pack import Pack
from lidar_emu.trial.solutions import REJECTED, Solutions, Trust

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIGMAS = 3.0
_PASS, _WRONG = "#2f9e5f", "#e0393e"
_AXES = {"east": "#a9825a", "north": "#7d9440", "up": INK}
"""Colours of components, which are none of the beams'."""
_STATED = "#c93bc0"
_MOST_COLUMNS = 4
_BAND_POINTS = 300
"""Points across a panel, more than it has dots: bands are smooth, and lines are thinned by matplotlib."""
_PNG_COLOURS = 256


def write_page(path: Path, pack: Pack, verdicts: Sequence[CaseVerdict], picture: Drawing) -> None:
    """Write the page, with the picture of all cases on top.

    Raises:
        RunError: writing failed.
    """
    rows = [(one.case.case.id, "pass" if one.passes else "FAIL", *_first_misses(one)) for one in verdicts]
    parts = [
        f"<h1>Trial: {escape(pack.name)}</h1>",
        f"<p>{escape(pack.text)}</p>",
        figure_element(picture),
        html_table(("case", "verdict", "requirements that are missed"), rows),
        *(part for one in verdicts for part in _chapter(one)),
    ]
    with whole_file(path) as file:
        file.write(page_document(f"Trial: {pack.name}", parts).encode())


def _first_misses(verdict: CaseVerdict) -> tuple[str]:
    missed = [f"{one.requirement.id}: {described(one)}" for one in verdict.judged if one.verdict != "pass"]
    problems = dict.fromkeys(each.problem for each in verdict.flights if each.problem)
    return ("; ".join(problems or missed),)


def _chapter(verdict: CaseVerdict) -> Iterator[str]:
    case = verdict.case.case
    yield heading(f"{case.id}: {'pass' if verdict.passes else 'FAIL'}")
    yield f"<p>{escape(case.question)}</p>"
    for title, text in (("Known", case.known), ("Assumed", case.assumed)):
        if text:
            yield note(f"{title}: {text}")
    yield html_table(
        ("requirement", "verdict", "worst", "limit", "flights", "quantity", "text"),
        [
            (
                one.requirement.id,
                str(one.verdict),
                *cells(one),
                one.requirement.quantity,
                one.requirement.text,
            )
            for one in verdict.judged
        ],
    )
    shown = _shown_flight(verdict)
    if shown.grade is not None:
        yield figure_element(flight_drawing(shown, shown.grade))
    missed = [line for one in verdict.judged for line in lines_of(one, verdict)]
    command = [f"seed {shown.seed}{f', {shown.problem}' if shown.problem else ''}: {shown.command}"]
    yield "<pre>" + escape("\n".join(dict.fromkeys(missed or command))) + "</pre>"


def _shown_flight(verdict: CaseVerdict) -> Flown:
    """The flight with the worst miss of the first requirement that is missed; the first, where none is."""
    missed = next((one.missed[0].seed for one in verdict.judged if one.missed), verdict.flights[0].seed)
    return next(one for one in verdict.flights if one.seed == missed)


def overview(pack: Pack, verdicts: Sequence[CaseVerdict]) -> Drawing:
    """The picture of a trial: for each case the descent over the ground, and the ground that the navigation states."""
    passed = sum(one.passes for one in verdicts)
    columns = min(_MOST_COLUMNS, len(verdicts))
    rows = -(-len(verdicts) // columns)
    caption = (
        "The path over the ground against time, and the ground where the navigation states it: below the vehicle by "
        f"the altitude that it states, with {_SIGMAS:g} of the sigmas that it states; dotted where it uses no range. "
        "Below each, the error of that altitude and these sigmas. Red: a beam reports wrong values as valid; the marks "
        "at the upper edge are in that beam's colour."
    )
    title = f"{pack.name}: {passed} of {len(verdicts)} cases pass"
    return draw_figure(
        "overview",
        "All cases",
        caption,
        1.1 + 3.2 * rows,
        lambda figure: _plot_overview(figure, title, (rows, columns), verdicts),
    )


def write_overview(drawing: Drawing, path: Path) -> None:
    """Write the picture of a trial, a PNG in few colours: a third of the bytes.

    Raises:
        InputError: the file cannot be written.
        RunError: writing failed.
    """
    write_drawing(drawing, path)
    if path.suffix == ".png":
        from PIL import Image

        with Image.open(path) as image:
            # This way of choosing them contains the beams' colours.
            few = image.convert("RGB").quantize(_PNG_COLOURS, Image.Quantize.MAXCOVERAGE)
        with whole_file(path) as file:
            few.save(file, "png", optimize=True)


def _plot_overview(
    figure: Figure, title: str, shape: tuple[int, int], verdicts: Sequence[CaseVerdict]
) -> None:
    (rows, columns), count = shape, len(verdicts)
    panels = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=[2, 1] * rows)
    questions = [wrap(one.case.case.question, 41 * _MOST_COLUMNS // columns) for one in verdicts]
    most = max(map(len, questions))  # so that all begin at the same height
    for place in range(rows * columns):
        row, column = divmod(place, columns)
        descent, error = panels[2 * row, column], panels[2 * row + 1, column]
        if place >= count:
            descent.set_axis_off()
            error.set_axis_off()
            continue
        _prepare_panel(descent, error, is_left=column == 0, is_lowest=place + columns >= count)
        question = questions[place] + [""] * (most - len(questions[place]))
        _describe_case(descent, verdicts[place], question)
        found = _shown_flight(verdicts[place]).grade
        if found is not None:
            _plot_descent(descent, error, found)
    figure.suptitle(title, fontsize=14, fontweight="bold")
    _overview_legend(figure, [_shown_flight(one).grade for one in verdicts])


def _prepare_panel(descent: Axes, error: Axes, *, is_left: bool, is_lowest: bool) -> None:
    from matplotlib.ticker import MaxNLocator

    descent.sharex(error)
    descent.tick_params(labelbottom=False)
    descent.yaxis.set_major_locator(MaxNLocator(4))
    error.set_yscale("symlog", linthresh=0.1, linscale=0.3)
    error.set_ylim(-4e3, 4e3)
    error.set_yticks([-100, -1, 1, 100], ["-100", "-1", "1", "100"] if is_left else [""] * 4)
    error.minorticks_off()
    error.axhline(0, color=GRID, linewidth=0.6)
    for axes in (descent, error):
        axes.tick_params(labelsize=7, length=2)
        axes.grid(visible=False)
    if is_left:
        descent.set_ylabel("height (m)", fontsize=8)
        error.set_ylabel("altitude\nerror (m)", fontsize=8)
    if is_lowest:
        error.set_xlabel("time (s)", fontsize=8)


def _overview_legend(figure: Figure, grades: Sequence[Grade | None]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    beams = sorted({each.beam for found in grades if found is not None for each in found.deceptions})
    figure.legend(
        handles=[
            Line2D([], [], color=INK, linewidth=1.0, label="path"),
            Patch(color=GRID, alpha=0.45, linewidth=0, label="ground"),
            Line2D([], [], color=_STATED, linewidth=1.4, label="ground, as stated"),
            Line2D([], [], color=_STATED, linewidth=1.4, linestyle=":", label="no range used"),
            Patch(color=_STATED, alpha=0.2, linewidth=0, label=f"{_SIGMAS:g} stated sigmas"),
            Patch(color=_WRONG, alpha=0.2, linewidth=0, label="wrong, but reported as valid:"),
            *(Line2D([], [], color=beam_colour(beam), linewidth=3, label=f"beam {beam}") for beam in beams),
        ],
        loc="outside lower center",
        ncols=6 + len(beams),
        handlelength=1.2,
        columnspacing=0.9,
        fontsize=8,
    )


def _describe_case(axes: Axes, verdict: CaseVerdict, question: list[str]) -> None:
    word, colour = ("pass", _PASS) if verdict.passes else ("FAIL", _WRONG)
    axes.set_title(
        verdict.case.case.id, loc="left", fontsize=9.5, fontweight="bold", pad=3 + 9 * len(question)
    )
    axes.text(
        0, 1.02, "\n".join(question), transform=axes.transAxes, fontsize=6.6, va="bottom", in_layout=False
    )
    missed = [one.requirement.id for one in verdict.judged if one.verdict != "pass"]
    misses = wrap(_shown_flight(verdict).problem or ", ".join(missed), 24)
    corner: Any = {"transform": axes.transAxes, "ha": "right", "va": "top", "color": colour}
    axes.text(0.98, 0.87, word, fontsize=11, fontweight="bold", **corner)
    axes.text(0.98, 0.74, "\n".join(misses), fontsize=7, **corner)


def _plot_descent(descent: Axes, error: Axes, found: Grade) -> None:
    stated, truth = _during_flight(found)
    time_s, up_m, altitude_m = stated.time_s, truth.position_site_m[:, 2], truth.altitude_m
    path_m, path_ground_m = found.flight.position_site_m[:, 2], _ground_m(found.flight)
    band_m = _SIGMAS * np.nan_to_num(stated.sigma_altitude_m)
    stated_m = up_m - stated.altitude_m
    low_m, high_m = np.nanmin(np.append(path_ground_m, path_m.min())), path_m.max()
    margin_m = 0.06 * (high_m - low_m)
    descent.set_ylim(low_m - margin_m, high_m + 2 * margin_m)
    few = slice(None, None, 1 + len(path_m) // _BAND_POINTS)
    descent.fill_between(
        found.flight_s[few], path_ground_m[few], low_m - margin_m, color=GRID, alpha=0.45, linewidth=0
    )
    descent.plot(found.flight_s, path_m, "-", color=INK, linewidth=1.0)
    few = slice(None, None, 1 + len(time_s) // _BAND_POINTS)
    uses = (stated.range_trust == Trust.USED).any(axis=1)
    for axes, value_m in ((descent, stated_m), (error, stated.altitude_m - altitude_m)):
        middle_m = value_m if axes is descent else np.zeros(len(time_s))
        below_m, above_m = (middle_m - band_m)[few], (middle_m + band_m)[few]
        axes.fill_between(time_s[few], below_m, above_m, color=_STATED, alpha=0.2, linewidth=0)
        axes.plot(time_s, np.where(uses, np.nan, value_m), ":", color=_STATED, linewidth=1.2)
        axes.plot(time_s, np.where(uses, value_m, np.nan), "-", color=_STATED, linewidth=1.2)
        _shade_deceptions(axes, found.deceptions)
    for each in found.deceptions:
        edge = [0.985 - 0.028 * each.beam] * 2
        ends_s = [each.from_s, max(each.until_s, each.from_s + 0.3)]
        across = descent.get_xaxis_transform()
        descent.plot(
            ends_s, edge, color=beam_colour(each.beam), lw=2.2, solid_capstyle="butt", transform=across
        )


def _ground_m(motion: TrueMotion) -> FloatArray:
    """Height of the ground straight below; NaN where there is none."""
    return np.asarray(motion.position_site_m[:, 2] - motion.altitude_m)


def _during_flight(found: Grade) -> tuple[Solutions, TrueMotion]:
    """Solutions and truth at times of the flight: others would stretch the axes."""
    inside = np.isfinite(found.truth.position_site_m[:, 0])

    def cut(columns: tuple[Any, ...]) -> Iterator[Any]:
        return (column[inside] for column in columns)

    return Solutions(*cut(found.stated)), TrueMotion(*cut(found.truth))


def _shade_deceptions(axes: Axes, deceptions: Sequence[Deception]) -> None:
    for from_s, until_s in _joined(deceptions):
        axes.axvspan(from_s, until_s, color=_WRONG, alpha=0.14, linewidth=0.5)


def _joined(deceptions: Sequence[Deception]) -> list[tuple[float, float]]:
    """Times in which at least one beam deceives, one after the other."""
    found: list[tuple[float, float]] = []
    for each in sorted(deceptions, key=lambda one: one.from_s):
        if found and each.from_s <= found[-1][1]:
            found[-1] = (found[-1][0], max(found[-1][1], each.until_s))
        else:
            found.append((each.from_s, each.until_s))
    return found


def flight_drawing(flown: Flown, found: Grade) -> Drawing:
    """The figure of a flight: errors of altitude and velocity, and what became of each beam's values."""
    case = flown.case.case.id
    caption = (
        f"Errors of altitude and velocity, with {_SIGMAS:g} of the sigmas that the navigation states (grey). Below, "
        "what it did with the range and the speed of each beam: used (beam's colour), rejected (text's colour), not "
        "valid (thin line). Red: the beam reports wrong values as valid; in the upper panels, at least one does."
    )
    return draw_figure(case, f"{case}, seed {flown.seed}", caption, 6.5, lambda figure: _plot(figure, found))


def _plot(figure: Figure, found: Grade) -> None:
    altitude, velocity, trust = figure.subplots(3, 1, sharex=True)
    stated, truth = _during_flight(found)
    _error_panel(
        altitude,
        "altitude error (m)",
        1.0,
        stated.time_s,
        stated.altitude_m - truth.altitude_m,
        stated.sigma_altitude_m,
    )
    error_mps = stated.velocity_site_mps - truth.velocity_site_mps
    for axis, (name, colour) in enumerate(_AXES.items()):
        sigma_mps = (
            stated.sigma_velocity_mps[:, axis] if name == "up" else np.full(len(stated.time_s), np.nan)
        )
        _error_panel(
            velocity, "velocity error (m/s)", 0.1, stated.time_s, error_mps[:, axis], sigma_mps, colour, name
        )
    velocity.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(_AXES), fontsize=9)
    for axes in (altitude, velocity):
        axes.plot(found.flight_s[[0, -1]], [0, 0], "-", color=GRID, linewidth=0.6)
        _shade_deceptions(axes, found.deceptions)
    _trust_panel(trust, stated, found.deceptions)
    trust.set_xlabel("time from the start of the flight (s)")


def _error_panel(
    axes: Axes,
    label: str,
    linear: float,
    time_s: FloatArray,
    error: FloatArray,
    sigma: FloatArray,
    colour: str = INK,
    name: str = "",
) -> None:
    known = np.isfinite(sigma)
    axes.fill_between(
        time_s[known], -_SIGMAS * sigma[known], _SIGMAS * sigma[known], color=GRID, alpha=0.3, linewidth=0
    )
    axes.plot(time_s, error, "-", color=colour, linewidth=0.9, label=name or None)
    # Errors before the first range are a thousand times those at the end.
    axes.set_yscale("symlog", linthresh=linear, linscale=0.5)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.minorticks_off()
    axes.set_ylabel(label)


def _trust_panel(axes: Axes, stated: Solutions, deceptions: Sequence[Deception]) -> None:
    rows = [
        (quantity, beam, codes)
        for quantity, trust in (("range", stated.range_trust), ("speed", stated.speed_trust))
        for beam, codes in enumerate(trust.T)
        if (codes != Trust.NOT_JUDGED).any()
    ]
    for row, (quantity, beam, codes) in enumerate(rows):
        for each in deceptions:
            if (each.quantity, each.beam) == (quantity, beam):
                span = [(each.from_s, each.until_s - each.from_s)]
                axes.broken_barh(span, (row - 0.5, 1.0), color=_WRONG, alpha=0.35, linewidth=0.5)
        for which, colour, half in (
            (codes == Trust.USED, beam_colour(beam), 0.22),
            (codes == Trust.INVALID, GRID, 0.05),
            (np.isin(codes, REJECTED), INK, 0.22),
        ):
            spans = _spans(stated.time_s, which)
            axes.broken_barh(spans, (row - half, 2 * half), color=colour, linewidth=0.4)
    axes.set_yticks(range(len(rows)), [f"{quantity} {beam}" for quantity, beam, _ in rows])
    axes.set_ylim(max(len(rows), 1) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def _spans(time_s: FloatArray, which: BoolArray) -> list[tuple[float, float]]:
    """Begin and duration of each run of solutions, up to the solution that follows it."""
    edges = np.diff(which.astype(np.int8), prepend=0, append=0)
    ends_s = np.append(time_s, time_s[-1:])
    begin_s, end_s = ends_s[np.flatnonzero(edges == 1)], ends_s[np.flatnonzero(edges == -1)]
    return list(zip(begin_s.tolist(), (end_s - begin_s).tolist(), strict=True))

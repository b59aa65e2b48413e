"""The page of a trial: for each case its verdicts, the errors beside the stated sigmas, and the trust in each beam."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.report.html_parts import figure_element, heading, html_table, note, page_document
from lidar_emu.report.plot_style import GRID, INK, Drawing, draw_figure, write_drawing
from lidar_emu.trial.fly import Flown
from lidar_emu.trial.grading import STALE_S, Deception, Grade
from lidar_emu.trial.judge import CaseVerdict, cells, in_band, lines_of, missed_spans, spans
from lidar_emu.trial.pack import Pack
from lidar_emu.trial.solutions import REJECTED, Solutions, Trust

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIGMAS = 3.0
_PASS, _FAIL, _WRONG = "#2f9e5f", "#e0393e", "#f0b429"
_AXES = {"east": "#a9825a", "north": "#7d9440", "up": INK}
"""Colours of components, which are none of the beams'."""
_STATED = "#c93bc0"
_BAND = "±3 σ, as the navigator states its σ"
_LIMIT: Any = {"color": INK, "linewidth": 0.9, "linestyle": "--"}
_KINDS = {"altitude": ("altitude",), "velocity": ("velocity", "vertical_speed")}
"""Beginnings of the quantities that are on an error."""
_MOST_COLUMNS, _LETTERS_ACROSS, _LINE_POINTS = 3, 126, 11.2
_SILENT_PERIODS = 10.0
"""A line is not drawn over times that are this much longer than the median between two solutions."""
_BAND_POINTS = 300
"""Points across a panel, more than it has dots: bands are smooth, and lines are thinned by matplotlib."""
_PNG_COLOURS = 256


def write_page(path: Path, pack: Pack, verdicts: Sequence[CaseVerdict], picture: Drawing) -> None:
    """Write the page, with the picture of all cases on top.

    Raises:
        RunError: writing failed.
    """
    rows = [(one.case.case.id, "pass" if one.passes else "FAIL", one.miss) for one in verdicts]
    parts = [
        f"<h1>Trial: {escape(pack.name)}</h1>",
        f"<p>{escape(pack.text)}</p>",
        figure_element(picture),
        html_table(("case", "verdict", "what is missed"), rows),
        *(part for one in verdicts for part in _chapter(one)),
    ]
    with whole_file(path) as file:
        file.write(page_document(f"Trial: {pack.name}", parts).encode())


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
            (need.id, str(one.verdict), *cells(one), need.quantity, need.text)
            for need, one in zip(verdict.case.requirements, verdict.judged, strict=True)
        ],
    )
    shown = verdict.shown_flight
    if shown.grade is not None:
        yield figure_element(flight_drawing(shown, shown.grade))
    missed = [line for one in verdict.judged for line in lines_of(one, verdict)]
    command = [f"seed {shown.seed}{f', {shown.problem}' if shown.problem else ''}: {shown.command}"]
    yield "<pre>" + escape("\n".join(dict.fromkeys(missed or command))) + "</pre>"


def overview(pack: Pack, verdicts: Sequence[CaseVerdict]) -> Drawing:
    """The picture of a trial: for each case the descent, and the error that the first missed requirement is on."""
    passed = sum(one.passes for one in verdicts)
    columns = min(_MOST_COLUMNS, len(verdicts))
    rows = -(-len(verdicts) // columns)
    caption = (
        "The path over the ground against time, and the ground where the navigation states it: below the vehicle by "
        f"the altitude that it states, with {_BAND}; dotted where it uses no range. Below each, the error of that "
        "altitude, or of velocity where a requirement on that is missed; red, when it is missed. Yellow: a beam "
        "reports wrong values as valid; the marks at the upper edge are in that beam's colour."
    )
    title, text = (
        f"{pack.name}: {passed} of {len(verdicts)} cases pass",
        wrap(pack.text.partition(". ")[0], 110),
    )
    return draw_figure(
        "overview",
        "All cases",
        caption,
        1.2 + 3.0 * rows,
        lambda figure: _plot_overview(figure, title, text, (rows, columns), verdicts),
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
    figure: Figure, title: str, text: list[str], shape: tuple[int, int], verdicts: Sequence[CaseVerdict]
) -> None:
    (rows, columns), count = shape, len(verdicts)
    panels = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=[1.4, 1] * rows)
    width = _LETTERS_ACROSS // columns
    texts = [(_lines(one.case.case.question, width), _lines(one.miss, width)) for one in verdicts]
    for place in range(rows * columns):
        row, column = divmod(place, columns)
        descent, error = panels[2 * row, column], panels[2 * row + 1, column]
        if place >= count:
            descent.set_axis_off()
            error.set_axis_off()
            continue
        verdict, found = verdicts[place], verdicts[place].shown_flight.grade
        _prepare_panel(descent, error, is_left=column == 0, is_lowest=place + columns >= count)
        # The most lines in the row, so that all its cases begin at the same height.
        most = max(len(asked) + len(miss) for asked, miss in texts[row * columns : (row + 1) * columns])
        _describe_case(descent, verdict, *texts[place], most)
        if found is not None:
            _plot_descent(descent, found)
            _plot_error(error, verdict, found)
    figure.set_layout_engine("constrained", h_pad=0.05)
    # Its empty lines are the place of the legend, which matplotlib would lay on the title.
    figure.suptitle(title + (3 + len(text)) * "\n", fontsize=15, fontweight="bold")
    _overview_legend(figure, text, [one.shown_flight.grade for one in verdicts])


def _lines(text: str, width: int) -> list[str]:
    """Lines of a text in which units stay with their numbers."""
    return wrap(re.sub(r"(?<=\d) ", "\N{NO-BREAK SPACE}", text), width)


def _prepare_panel(descent: Axes, error: Axes, *, is_left: bool, is_lowest: bool) -> None:
    from matplotlib.ticker import MaxNLocator

    descent.sharex(error)
    descent.tick_params(labelbottom=False)
    descent.yaxis.set_major_locator(MaxNLocator(4))
    for axes in (descent, error):
        axes.tick_params(labelsize=8, length=2)
        axes.grid(visible=False)
    if is_left:
        descent.set_ylabel("height (m)")
    if is_lowest:
        error.set_xlabel("time (s)")


def _overview_legend(figure: Figure, text: list[str], grades: Sequence[Grade | None]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    beams = sorted({each.beam for found in grades if found is not None for each in found.deceptions})
    line: Any = {"color": _STATED, "linewidth": 1.4}
    handles = [
        Line2D([], [], color=INK, linewidth=1.0, label="true path"),
        Patch(color=GRID, alpha=0.45, linewidth=0, label="true ground"),
        Line2D([], [], **line, label="navigator's ground; lower panel: error"),
        Line2D([], [], **line, linestyle=":", label="the same, while it uses no range"),
        Patch(color=_STATED, alpha=0.2, linewidth=0, label=_BAND),
        Line2D([], [], **_LIMIT, label="required limit of the error"),
        Patch(color=_FAIL, alpha=0.25, linewidth=0, label="requirement missed"),
        Patch(color=_WRONG, alpha=0.25, linewidth=0, label="lidar wrong, flagged valid"),
        *(Line2D([], [], color=beam_colour(beam), linewidth=3, label=f"in beam {beam}") for beam in beams),
    ]
    figure.legend(
        handles=handles,
        title="\n".join(text),
        title_fontsize=10,
        loc="upper center",
        bbox_to_anchor=(0.5, 1.0 - 0.36 / figure.get_figheight()),
        ncols=5 if beams else 4,
        handlelength=1.4,
        columnspacing=1.2,
    )


def _describe_case(axes: Axes, verdict: CaseVerdict, question: list[str], miss: list[str], most: int) -> None:
    word, colour = ("pass", _PASS) if verdict.passes else ("FAIL", _FAIL)
    high = 4 + _LINE_POINTS * most
    how: Any = {"fontsize": 11, "fontweight": "bold", "pad": high + 3}
    axes.set_title(verdict.case.case.id, loc="left", **how)
    axes.set_title(word, loc="right", color=colour, **how)
    how = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "top", "in_layout": False}
    axes.annotate("\n".join(question), (0, 1), (0, high), fontsize=8.5, **how)
    below = high - _LINE_POINTS * len(question)
    axes.annotate("\n".join(miss), (0, 1), (0, below), fontsize=8.5, color=_FAIL, **how)


def _plot_descent(axes: Axes, found: Grade) -> None:
    up_m, stated = found.truth.position_site_m[:, 2], found.stated
    path_m = found.flight.position_site_m[:, 2]
    ground_m = path_m - found.flight.altitude_m
    low_m, high_m = np.nanmin(np.append(ground_m, path_m.min())), path_m.max()
    margin_m = 0.06 * (high_m - low_m)
    floor_m = low_m - margin_m
    axes.set_ylim(floor_m, high_m + 2 * margin_m)
    axes.set_xlim(0.0, found.flight_s[-1])
    few = slice(None, None, 1 + len(path_m) // _BAND_POINTS)
    axes.fill_between(found.flight_s[few], ground_m[few], floor_m, color=GRID, alpha=0.45, linewidth=0)
    axes.plot(found.flight_s, path_m, "-", color=INK, linewidth=1.0)
    stated_m = up_m - stated.altitude_m
    _plot_stated(axes, found, stated_m, stated_m, stated.sigma_altitude_m)
    across = axes.get_xaxis_transform()
    for each in found.deceptions:
        edge = [0.985 - 0.032 * each.beam] * 2
        ends_s = [each.from_s, max(each.until_s, each.from_s + 0.3)]
        axes.plot(ends_s, edge, color=beam_colour(each.beam), lw=2.2, solid_capstyle="butt", transform=across)


def _plot_error(axes: Axes, verdict: CaseVerdict, found: Grade) -> None:
    """Plot the error of altitude, or of velocity if the first requirement that is missed is one on it."""
    missed = verdict.first_missed
    quantity = "" if missed is None else missed.quantity
    kind, linear = ("velocity", 1e-3) if quantity.startswith(_KINDS["velocity"]) else ("altitude", 0.1)
    errors, sigmas = found.errors(kind)
    # Of velocity, the component that is worst.
    ratio = np.nan_to_num(np.abs(errors) / np.where(sigmas > 0, sigmas, 1.0)).mean(axis=0)
    axis = 2 if quantity.startswith("vertical") else int(ratio.argmax())
    error = errors[:, axis]
    label = "altitude error (m)" if kind == "altitude" else f"velocity error, {list(_AXES)[axis]} (m/s)"
    axes.set_title(label, loc="left", fontsize=8.5, pad=3)
    _plot_stated(axes, found, np.zeros(len(error)), error, sigmas[:, axis])
    axes.axhline(0, color=GRID, linewidth=0.6)
    tops = [10.0 * linear, *np.abs(error[np.isfinite(error)])]
    for one in verdict.case.requirements:
        if one.solution and one.quantity.startswith(_KINDS[kind]) and "_error_m" in one.quantity:
            limit = np.where(in_band(one, found), one.limit, np.nan)
            axes.plot(found.stated.time_s, np.stack([-limit, limit], axis=1), **_LIMIT)
            tops.append(one.limit)
    top = 2.0 * float(max(tops))
    axes.set_yscale("symlog", linthresh=linear, linscale=0.8)
    axes.set_ylim(-top, top)
    decade = 10.0 ** np.floor(np.log10(top))
    ticks = [tick for tick in (-decade, -decade / 100, decade / 100, decade) if abs(tick) >= linear]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    if missed is not None:
        axes.broken_barh(missed_spans(missed, found), (-top, 2 * top), color=_FAIL, alpha=0.25, linewidth=0)


def _plot_stated(axes: Axes, found: Grade, middle: FloatArray, value: FloatArray, sigma: FloatArray) -> None:
    """Plot what the navigation states or its error, and its band; both end where it is silent for long."""
    time_s, uses = found.stated.time_s, (found.stated.range_trust == Trust.USED).any(axis=1)
    period_s = np.diff(time_s, prepend=time_s[:1])
    speaks = period_s <= max(STALE_S, _SILENT_PERIODS * np.median(period_s)) if len(time_s) else uses
    few = slice(None, None, 1 + len(time_s) // _BAND_POINTS)
    band = np.where(speaks, _SIGMAS * np.nan_to_num(sigma), np.nan)
    axes.fill_between(
        time_s[few], (middle - band)[few], (middle + band)[few], color=_STATED, alpha=0.2, linewidth=0
    )
    for which, style in ((~uses, ":"), (uses, "-")):
        shown = np.where(which & speaks, value, np.nan)
        axes.plot(time_s, shown, style, color=_STATED, linewidth=1.2)
    _shade_deceptions(axes, found.deceptions)


def _shade_deceptions(axes: Axes, deceptions: Sequence[Deception]) -> None:
    for from_s, until_s in _joined(deceptions):
        axes.axvspan(from_s, until_s, color=_WRONG, alpha=0.25, linewidth=0.5)


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
        f"Errors of altitude and velocity, with {_BAND} (grey). Below, "
        "what it did with the range and the speed of each beam: used (beam's colour), rejected (text's colour), not "
        "valid (thin line). Yellow: the beam reports wrong values as valid; in the upper panels, at least one does."
    )
    return draw_figure(case, f"{case}, seed {flown.seed}", caption, 6.5, lambda figure: _plot(figure, found))


def _plot(figure: Figure, found: Grade) -> None:
    altitude, velocity, trust = figure.subplots(3, 1, sharex=True)
    time_s = found.stated.time_s
    for axes, kind, unit, linear, names in (
        (altitude, "altitude", "m", 1.0, {"": INK}), (velocity, "velocity", "m/s", 0.1, _AXES)
    ):  # fmt: skip
        errors, sigmas = found.errors(kind)
        band = _SIGMAS * sigmas[:, -1]
        axes.fill_between(time_s, -band, band, color=GRID, alpha=0.3, linewidth=0)
        for error, (name, colour) in zip(errors.T, names.items(), strict=True):
            axes.plot(time_s, error, "-", color=colour, linewidth=0.9, label=name or None)
        axes.plot(found.flight_s[[0, -1]], [0, 0], "-", color=GRID, linewidth=0.6)
        _shade_deceptions(axes, found.deceptions)
        # Errors before the first range are a thousand times those at the end.
        axes.set_yscale("symlog", linthresh=linear, linscale=0.5)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.minorticks_off()
        axes.set_ylabel(f"{kind} error ({unit})")
    velocity.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(_AXES), fontsize=9)
    _trust_panel(trust, found.stated, found.deceptions)
    trust.set_xlim(0.0, found.flight_s[-1])
    trust.set_xlabel("time from the start of the flight (s)")


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
            axes.broken_barh(spans(stated.time_s, which), (row - half, 2 * half), color=colour, linewidth=0.4)
    axes.set_yticks(range(len(rows)), [f"{quantity} {beam}" for quantity, beam, _ in rows])
    axes.set_ylim(max(len(rows), 1) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")

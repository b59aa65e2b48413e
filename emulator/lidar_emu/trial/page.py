"""The page of a trial: for each case its verdicts, the errors beside the stated sigmas, and the trust in each beam."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.html_parts import figure_element, heading, html_table, note, page_document
from lidar_emu.report.plot_style import Drawing, draw_figure
from lidar_emu.trial.fly import Flown
from lidar_emu.trial.grading import Deception, Grade
from lidar_emu.trial.judge import CaseVerdict, cells, described, lines_of
from lidar_emu.trial.pack import Pack
from lidar_emu.trial.solutions import REJECTED, Solutions, Trust

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIGMAS = 3.0


def write_page(path: Path, pack: Pack, verdicts: Sequence[CaseVerdict]) -> None:
    """Write the page.

    Raises:
        RunError: writing failed.
    """
    rows = [(one.case.case.id, "pass" if one.passes else "FAIL", *_first_misses(one)) for one in verdicts]
    parts = [
        f"<h1>Trial: {escape(pack.name)}</h1>",
        f"<p>{escape(pack.text)}</p>",
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
    shown = _most_telling(verdict)
    if shown.grade is not None:
        yield figure_element(_drawing(shown, shown.grade))
    missed = [line for one in verdict.judged for line in lines_of(one, verdict)]
    command = [f"seed {shown.seed}{f', {shown.problem}' if shown.problem else ''}: {shown.command}"]
    yield "<pre>" + escape("\n".join(dict.fromkeys(missed or command))) + "</pre>"


def _most_telling(verdict: CaseVerdict) -> Flown:
    """The flight with the worst miss of the first requirement that is missed; the first, where none is."""
    missed = next((one.missed[0].seed for one in verdict.judged if one.missed), verdict.flights[0].seed)
    return next(one for one in verdict.flights if one.seed == missed)


def _drawing(flown: Flown, found: Grade) -> Drawing:
    case = flown.case.case.id
    caption = (
        f"Errors of altitude and velocity, with {_SIGMAS:g} of the sigmas that the navigation states (grey); what it "
        "did with each beam's range and speed: used (blue), rejected (orange), not valid (grey). "
        "Red: a beam deceives."
    )
    return draw_figure(case, f"{case}, seed {flown.seed}", caption, 6.5, lambda figure: _plot(figure, found))


def _plot(figure: Figure, found: Grade) -> None:
    altitude, velocity, trust = figure.subplots(3, 1, sharex=True)
    stated, truth = found.stated, found.truth
    _error_panel(
        altitude,
        "altitude error (m)",
        stated.time_s,
        stated.altitude_m - truth.altitude_m,
        stated.sigma_altitude_m,
    )
    error_mps = stated.velocity_site_mps - truth.velocity_site_mps
    for axis, name in enumerate(("east", "north", "up")):
        sigma_mps = stated.sigma_velocity_mps[:, axis] if axis == 2 else np.full(len(stated.time_s), np.nan)
        _error_panel(
            velocity, "velocity error (m/s)", stated.time_s, error_mps[:, axis], sigma_mps, f"C{axis}", name
        )
    velocity.legend(loc="upper right", ncols=3, frameon=False)
    _trust_panel(trust, stated, found.deceptions)
    for axes in (altitude, velocity, trust):
        for each in found.deceptions:
            axes.axvspan(
                each.from_s, max(each.until_s, each.from_s + 0.05), color="C3", alpha=0.15, linewidth=0
            )
    trust.set_xlabel("time (s)")


def _error_panel(
    axes: Axes,
    label: str,
    time_s: FloatArray,
    error: FloatArray,
    sigma: FloatArray,
    colour: str = "C0",
    name: str = "",
) -> None:
    known = np.isfinite(sigma)
    axes.fill_between(
        time_s[known], -_SIGMAS * sigma[known], _SIGMAS * sigma[known], color="0.5", alpha=0.25, linewidth=0
    )
    axes.plot(time_s, error, "-", color=colour, linewidth=0.9, label=name or None)
    axes.set_ylabel(label)


def _trust_panel(axes: Axes, stated: Solutions, deceptions: Sequence[Deception]) -> None:
    beams = stated.range_trust.shape[1]
    rows = [(f"range {beam}", stated.range_trust[:, beam]) for beam in range(beams)]
    rows += [(f"speed {beam}", stated.speed_trust[:, beam]) for beam in range(beams)]
    rows = [(name, codes) for name, codes in rows if (codes != Trust.NOT_JUDGED).any()]
    for height, (name, codes) in enumerate(rows):
        for which, colour in (
            (codes == Trust.USED, "C0"),
            (np.isin(codes, REJECTED), "C1"),
            (codes == Trust.INVALID, "0.6"),
        ):
            axes.plot(stated.time_s[which], np.full(which.sum(), height), "|", color=colour, markersize=5)
        for each in deceptions:
            if name == f"{each.quantity} {each.beam}":
                axes.plot([each.from_s, each.until_s], [height + 0.35] * 2, "-", color="C3", linewidth=2.5)
    axes.set_yticks(range(len(rows)), [name for name, _ in rows])
    axes.invert_yaxis()

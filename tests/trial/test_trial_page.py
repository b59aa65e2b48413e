"""The pictures of a trial: what is drawn where, on solutions and deceptions that are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import same_color, to_hex
from PIL import Image

from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.trial.fly import Flown
from lidar_emu.trial.grading import FIGURES, SERIES, Deception, Grade, Series, TrueMotion
from lidar_emu.trial.judge import CaseVerdict, judge_case
from lidar_emu.trial.pack import Pack, TrialRequirement, read_pack
from lidar_emu.trial.page import flight_drawing, overview, write_overview, write_page
from lidar_emu.trial.solutions import Solutions, Trust

RED, YELLOW = "#e0393e", "#f0b429"
TIME_S = np.arange(101) / 10
DECEPTIONS = [
    Deception("range", 0, 2.0, 4.0, np.inf, np.inf),
    Deception("range", 1, 3.0, 5.0, np.inf, np.inf),
    Deception("speed", 1, 8.0, 9.0, np.inf, np.inf),
]


def grade() -> Grade:
    """A descent from 100 m to 50 m over ground that lies 20 m up, with an altitude that is 3 m too large."""
    count = len(TIME_S)
    altitude_m = 100 - 5 * TIME_S
    position_m = np.stack([np.zeros(count), np.zeros(count), altitude_m + 20], axis=1)
    ones = np.ones((count, 3))
    trust = np.full((count, 2), Trust.USED, dtype=np.int8)
    trust[60:80, 1] = Trust.GATED
    stated = Solutions(
        TIME_S, TIME_S, altitude_m + 3, np.ones(count), position_m, ones, 0 * ones, ones, trust, trust.copy()
    )
    truth = TrueMotion(position_m, 0 * ones, altitude_m)
    series = {name: Series(np.zeros(count), altitude_m) for name in SERIES}
    return Grade(stated, truth, TIME_S, truth, DECEPTIONS, series, dict.fromkeys(FIGURES, 1.0), {})


@pytest.fixture(scope="module")
def pack() -> Pack:
    return read_pack("nominal", ["moon", "mars"])


@pytest.fixture(scope="module")
def verdicts(pack: Pack) -> list[CaseVerdict]:
    """The first case passes, the second one fails without a grade."""
    first, second = pack.cases
    found = judge_case(first, [Flown(first, 1, "again", grade(), "")])
    assert found.passes
    return [found, judge_case(second, [Flown(second, 1, "again <2>", None, "the host ended")])]


def bars(axes: Axes, colour: str) -> set[tuple[float, ...]]:
    """Begin, end and middle of the bars of a colour."""
    return {
        (*np.round([path.vertices[:, 0].min(), path.vertices[:, 0].max(), path.vertices[:, 1].mean()], 1),)
        for each in axes.collections
        for path in each.get_paths()
        if len(path.vertices) and same_color(to_hex(each.get_facecolor()[0]), colour)
    }


def bands(axes: Axes, colour: str) -> list[tuple[float, float]]:
    """Begin and end of what spans the height of the axes."""
    return [
        (float(each.get_x()), float(each.get_x() + each.get_width()))
        for each in axes.patches
        if same_color(to_hex(each.get_facecolor()), colour)
    ]


def test_a_deception_is_in_its_own_row_and_one_band_in_the_errors(verdicts: list[CaseVerdict]) -> None:
    (flown,) = verdicts[0].flights
    altitude, velocity, trust = flight_drawing(flown, grade()).figure.axes
    for axes in (altitude, velocity):
        assert bands(axes, YELLOW) == [(2.0, 5.0), (8.0, 9.0)]
    rows = [label.get_text() for label in trust.get_yticklabels()]
    assert rows == ["range 0", "range 1", "speed 0", "speed 1"]
    assert not bands(trust, YELLOW)
    middles = {(begin, end, round(middle)) for begin, end, middle in bars(trust, YELLOW)}
    assert middles == {(2.0, 4.0, 0), (3.0, 5.0, 1), (8.0, 9.0, 3)}


def test_beams_have_their_colours_and_components_others(verdicts: list[CaseVerdict]) -> None:
    (flown,) = verdicts[0].flights
    _, velocity, trust = flight_drawing(flown, grade()).figure.axes
    used = {(begin, end) for begin, end, _ in bars(trust, beam_colour(1))}
    assert used == {(0.0, 6.0), (8.0, 10.0)}
    beams = {beam_colour(beam) for beam in range(8)}
    lines = [to_hex(line.get_color()) for line in velocity.lines if len(line.get_xdata()) == len(TIME_S)]
    assert len(set(lines)) == 3
    assert not beams & set(lines)


def test_the_overview_has_a_panel_a_case_with_its_verdict(
    pack: Pack, verdicts: list[CaseVerdict], tmp_path: Path
) -> None:
    drawing = overview(pack, verdicts)
    first, second = (axes for axes in drawing.figure.axes[:2])
    texts = [{text.get_text() for text in axes.texts} for axes in (first, second)]
    assert [axes.get_title("right") for axes in (first, second)] == ["pass", "FAIL"]
    assert "the host ended" in texts[1]
    assert drawing.figure.get_suptitle().strip() == "nominal: 1 of 2 cases pass"
    # The ground is stated 3 m too low.
    lines = [np.asarray(line.get_ydata()) for line in first.lines]
    assert any(np.allclose(line, 17) for line in lines if len(line) == len(TIME_S))
    marks = [line for line in first.lines if same_color(line.get_color(), beam_colour(1))]
    assert [tuple(line.get_xdata()) for line in marks] == [(3.0, 5.0), (8.0, 9.0)]
    write_overview(drawing, tmp_path / "all.png")
    with Image.open(tmp_path / "all.png") as image:
        assert (image.width, image.mode) == (1100, "P")
    write_overview(drawing, tmp_path / "all.svg")
    assert (tmp_path / "all.svg").read_text().count("moon") == 1


LIMITED = TrialRequirement(
    id="A", text="5 m.", solution="altitude_error_m_abs", at_most=2, altitude_m=(60, 80), share=0.5
)
CONSISTENT = TrialRequirement(id="C", text="90 %.", flight="velocity_within_3_sigma", at_least=0.9)
AVAILABLE = TrialRequirement(id="V", text="All.", flight="available_share", at_least=0.99)


@pytest.mark.parametrize(
    ("required", "words", "label", "red"),
    [
        (LIMITED, "5 m. Found: 50 % within 3 m.", "altitude error (m)", [(4.0, 8.1)]),
        (CONSISTENT, "90 %. Found: 50 %.", "velocity error, up (m/s)", [(2.0, 3.0)]),
        (AVAILABLE, "All. Found: 50 %.", "altitude error (m)", [(4.5, 6.0)]),
    ],
)
def test_the_overview_shows_what_was_missed_and_when(
    required: TrialRequirement, words: str, label: str, red: list[tuple[float, float]], pack: Pack
) -> None:
    """The altitude is 3 m off; vertical velocity is 4 sigma off from 2 s to 3 s; nothing arrives from 4 s to 6 s."""
    found = grade()
    found.stated.velocity_site_mps[20:30, 2] = 4.0
    found.series["altitude_error_m_abs"] = Series(np.full(len(TIME_S), 3.0), found.truth.altitude_m)
    found.stated.arrived_s[41:60] = 6.0
    found = found._replace(figures=dict.fromkeys(FIGURES, 0.5))
    case = pack.cases[0]._replace(requirements=[required])
    descent, error = overview(pack, [judge_case(case, [Flown(case, 1, "", found, "")])]).figure.axes
    assert any(words in text.get_text().replace("\xa0", " ") for text in descent.texts)
    assert error.get_title("left") == label
    assert [(begin, end) for begin, end, _ in sorted(bars(error, RED))] == red
    limits = [line for line in error.lines if line.get_linestyle() == "--"]
    known = [
        np.asarray(line.get_xdata())[np.isfinite(np.asarray(line.get_ydata(), dtype=float))]
        for line in limits
    ]
    assert [(x[0], x[-1]) for x in known] == ([(4.0, 8.0)] * 2 if required is LIMITED else [])


@pytest.mark.parametrize("offset_s", [0.0, 1e9])
def test_solutions_that_are_missing_or_of_other_times_do_not_stretch_the_axes(
    offset_s: float, pack: Pack, verdicts: list[CaseVerdict]
) -> None:
    """The last solution is outside the flight, or all are: there is no truth."""
    found, late = grade(), slice(0 if offset_s == 0 else -1, None)
    time_s, truth = TIME_S.copy(), TrueMotion(*(column.copy() for column in found.truth))
    time_s[late] += offset_s
    for column in truth:
        column[late] = np.nan
    found = found._replace(stated=found.stated._replace(time_s=time_s), truth=truth)
    (flown,) = verdicts[0].flights
    changed = verdicts[0]._replace(flights=[flown._replace(grade=found)])
    panel = overview(pack, [changed]).figure.axes[0]
    assert any(np.array_equal(line.get_ydata(), grade().flight.position_site_m[:, 2]) for line in panel.lines)
    for axes in (panel, *flight_drawing(flown, found).figure.axes):
        assert axes.get_xlim()[1] < 12


def test_the_page_has_the_picture_before_the_table(
    pack: Pack, verdicts: list[CaseVerdict], tmp_path: Path
) -> None:
    write_page(tmp_path / "trial.html", pack, verdicts, overview(pack, verdicts))
    page = (tmp_path / "trial.html").read_text()
    assert page.index('<figure id="overview">') < page.index("<table>") < page.index('<figure id="moon">')
    assert "again &lt;2&gt;" in page

"""The page about a flight, looked at by a browser."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest
from waiting import LIMIT_S

from lidar_emu.report.figures import Figures
from lidar_emu.report.html_parts import figure_element
from lidar_emu.report.page import write_page
from lidar_emu.report.plot_style import write_drawing as write_png
from lidar_emu.report.recorded_run import read_recorded_run

pytestmark = pytest.mark.slow
CHROMIUM = shutil.which("chromium")
FIGURES = ["path", "motion", "truth", "errors", "signal", "validity", "spectra"]
DARK = "--blink-settings=preferredColorScheme=0"


@pytest.fixture(scope="module")
def flight_page(record, tmp_path_factory) -> Path:
    settings = {"name": "<script>alert(1)</script>", "faults": "[{kind: dropout, beams: [2]}]"}
    flown = read_recorded_run(record("descent.yaml", duration_s="1", **settings))
    figures = Figures(flown, ())
    drawings = list(figures)
    folder = tmp_path_factory.mktemp("page")
    write_page(
        folder / "page.html",
        flown,
        ["shots      20 due"],
        [*map(figure_element, drawings)],
        figures.notes,
        figures.plan,
    )
    for drawing in drawings:
        write_png(drawing, folder / f"{drawing.name}.png")
    return folder / "page.html"


class Elements(HTMLParser):
    """Names, attributes and identifiers of all elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.all: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.all.append((tag, dict(attrs)))


def test_each_figure_is_there_with_words_and_names_of_its_own(flight_page):
    text = flight_page.read_text()
    elements = Elements(text).all
    figures = [attributes["id"] for tag, attributes in elements if tag == "figure"]
    assert sorted(figures) == sorted([*FIGURES, "timeline"])
    pictures = [attributes for tag, attributes in elements if tag == "svg"]
    assert len(pictures) == len(figures)
    assert all(len(each["aria-label"]) > 30 for each in pictures)
    names = [attributes["id"] for _, attributes in elements if attributes.get("id")]
    assert len(names) == len(set(names))
    assert set(re.findall(r"url\(#([^)]*)\)", text)) <= set(names)
    assert "dropout" in text
    assert len(text) < 3e6


def test_it_begins_with_the_path(flight_page):
    text = flight_page.read_text()
    assert text.index('<figure id="path">') < text.index("20 due") < text.index('<figure id="motion">')


def test_nothing_of_a_scenario_is_markup(flight_page):
    text = flight_page.read_text()
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text


def test_every_key_of_scenario_and_instrument_is_in_the_page(flight_page):
    from ruamel.yaml import YAML

    from lidar_emu.scenario.load import load

    blocks = [unescape(text) for text in re.findall(r"<pre>(.*?)</pre>", flight_page.read_text(), re.DOTALL)]
    scenario, instrument = (YAML(typ="safe").load(text) for text in blocks)
    flown = load("descent.yaml", {"duration_s": "1"}).model_dump(mode="json")
    assert instrument["instrument"] == flown.pop("instrument")
    assert scenario["faults"][0]["kind"] == "dropout"
    changed = ("name", "faults")
    assert {k: v for k, v in scenario.items() if k not in changed} == {
        k: v for k, v in flown.items() if k not in changed
    }


def test_figures_are_pictures(flight_page):
    from matplotlib.image import imread

    for name in FIGURES:
        picture = imread(flight_page.parent / f"{name}.png")[..., :3]
        assert picture.std() > 0.02
        assert picture[0, 0].min() == 1.0  # on white


def looked_at(page: Path, *options: str) -> tuple[str, list[str], list[str]]:
    """The document in a browser, the lines of its console, and the addresses that it requested."""
    log = page.parent / "net.json"
    command = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
               f"--user-data-dir={page.parent / 'profile'}", f"--log-net-log={log}", *options]  # fmt: skip
    done = subprocess.run(
        [*command, "--dump-dom", page.as_uri()], capture_output=True, text=True, check=True, timeout=LIMIT_S
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    text = log.read_text()
    asked = set(re.findall(r'"url":"(https?://[^"]*outside[^"]*)"', text))
    assert json.loads(text)["constants"]
    return done.stdout, console, sorted(asked)


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_browser_shows_it_without_complaint(flight_page):
    document, console, _ = looked_at(flight_page)
    assert console == []
    assert document.count("<svg") == len(FIGURES) + 1


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_browser_would_have_complained_and_asked(flight_page, tmp_path):
    """The same page with something from outside: with its own policy it is refused, without it is asked for."""
    outside = '<img src="http://outside.invalid/a.png"></body>'
    text = flight_page.read_text().replace("</body>", outside)
    (tmp_path / "refused.html").write_text(text)
    _, console, asked = looked_at(tmp_path / "refused.html")
    assert "Content Security Policy" in "".join(console)
    assert asked == []
    (tmp_path / "asked.html").write_text(text.replace("Content-Security-Policy", "Nothing"))
    assert looked_at(tmp_path / "asked.html")[2] != []

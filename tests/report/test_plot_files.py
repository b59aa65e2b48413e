"""Files of plots: the format is that of the suffix, and the same input gives the same bytes, whenever it is drawn."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread

from lidar_emu.report.beam_colours import BEAM_COLOURS
from lidar_emu.report.plot_style import DARK_INK, DARK_PAPER, INK, draw_figure, points, write_drawing


@pytest.mark.parametrize(("suffix", "begin"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_plot_is_what_its_suffix_names_and_has_no_date(suffix: str, begin: bytes, tmp_path: Path) -> None:
    x = np.arange(9.0)
    for path in (one := tmp_path / f"one.{suffix}", two := tmp_path / f"two.{suffix}"):
        write_drawing(draw_figure("n", "", "", 2.0, lambda figure: points(figure.subplots(), x, x)), path)
    assert (content := one.read_bytes()) == two.read_bytes()
    assert content.startswith(begin)
    assert not any(date in content for date in (b"CreationDate", b"<dc:date", b"tIME"))


def test_a_dark_plot_differs_by_ink_and_paper_alone(tmp_path: Path) -> None:
    def plot(figure: Figure) -> None:
        _, axes = figure.subplots(2, sharex=True)
        axes.semilogx([1, 9], [1, 9], "o-", color=BEAM_COLOURS[0], label="beam 0")
        axes.fill_between([2, 6], 5, 9, color=INK)
        how = {
            "fontsize": 30,
            "bbox": {"facecolor": "white"},
            "arrowprops": {"arrowstyle": "-", "color": INK},
        }
        axes.annotate("I", (8, 2), (3, 2), **how)
        axes.legend()

    seen = {}
    for name in ("light.png", "at-dark.png"):
        write_drawing(draw_figure("n", "", "", 2.0, plot), tmp_path / name)
        seen[name] = imread(tmp_path / name)[..., :3]
    light, dark = seen.values()
    for before, after in (("white", DARK_PAPER), (INK, DARK_INK), (BEAM_COLOURS[0], BEAM_COLOURS[0])):
        where = (np.abs(light - to_rgb(before)) < 1e-3).all(axis=-1)
        assert where.sum() > 200
        np.testing.assert_allclose(dark[where], np.broadcast_to(to_rgb(after), dark[where].shape), atol=1e-2)


@pytest.mark.parametrize("colour", [*BEAM_COLOURS, DARK_INK])
def test_colours_are_legible_on_dark_paper(colour: str) -> None:
    """The contrast of WCAG 2 is at least 3, as graphics need."""

    def luminance(name: str) -> float:
        value = np.array(to_rgb(name))
        linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    assert (luminance(colour) + 0.05) / (luminance(DARK_PAPER) + 0.05) > 3.0

"""Files of plots: the format is that of the suffix, and the same input gives the same bytes, whenever it is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from lidar_emu.errors import InputError
from lidar_emu.report.plot_style import (
    Drawing,
    check_plot_path,
    draw_figure,
    points,
    titled_figure,
    write_drawing,
    write_plot,
)

_BEGINS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


def plotted() -> Figure:
    figure = titled_figure("a title", (4.0, 3.0), 9.0)
    axes = figure.subplots()
    points(axes, np.arange(9.0), np.arange(9.0) ** 2)
    axes.fill_between([0, 1], [0, 1], clip_path=axes.patch)
    return figure


def drawn() -> Drawing:
    return draw_figure("errors", "", "", 2.0, lambda figure: figure.subplots().plot([1, 2]) and None)


@pytest.mark.parametrize("suffix", _BEGINS)
def test_a_plot_is_what_its_suffix_names_and_has_no_date(suffix: str, tmp_path: Path) -> None:
    contents = []
    for name in ("one", "two"):
        path = (tmp_path / name).with_suffix(suffix)
        check_plot_path(path)
        write_plot(plotted(), path)
        contents.append(path.read_bytes())
        write_drawing(drawn(), path)
        contents.append(path.read_bytes())
    assert contents[:2] == contents[2:]
    assert contents[0] != contents[1]
    for content in contents:
        assert content.startswith(_BEGINS[suffix])
        assert not any(date in content for date in (b"CreationDate", b"<dc:date", b"tIME"))


def test_other_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"unknown suffix \.jpg; use \.png, \.svg, \.pdf"):
        check_plot_path(tmp_path / "plot.jpg")

"""Files of plots: the format is that of the suffix, and the same input gives the same bytes, whenever it is drawn."""

from pathlib import Path

import numpy as np
import pytest

from lidar_emu.report.plot_style import draw_figure, points, write_drawing


@pytest.mark.parametrize(("suffix", "begin"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_plot_is_what_its_suffix_names_and_has_no_date(suffix: str, begin: bytes, tmp_path: Path) -> None:
    x = np.arange(9.0)
    for path in (one := tmp_path / f"one.{suffix}", two := tmp_path / f"two.{suffix}"):
        write_drawing(draw_figure("n", "", "", 2.0, lambda figure: points(figure.subplots(), x, x)), path)
    assert (content := one.read_bytes()) == two.read_bytes()
    assert content.startswith(begin)
    assert not any(date in content for date in (b"CreationDate", b"<dc:date", b"tIME"))

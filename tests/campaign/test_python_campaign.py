"""A campaign from Python: the tables of the command line, and refusals in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from small_campaign import SMALL

from lidar_emu import InputError, run_campaign
from lidar_emu.cli import cli
from lidar_emu.measurement import TABLE


@pytest.mark.slow
def test_the_tables_are_those_of_the_command_line(campaign_file: Callable[..., Path], tmp_path: Path) -> None:
    file = campaign_file(SMALL, 3)
    results = run_campaign(file, tmp_path / "python", {"timing.rate_hz": 10}, workers=1)
    options = [
        "--out",
        str(tmp_path / "cli"),
        "--workers",
        "1",
        "--set",
        "timing.rate_hz=10",
    ]
    done = CliRunner().invoke(cli, ["campaign", str(file), *options])
    assert done.exit_code == 0, done.output
    for part in sorted((tmp_path / "cli").rglob("*.parquet")):
        same = tmp_path / "python" / part.relative_to(tmp_path / "cli")
        assert same.read_bytes() == part.read_bytes(), part
    assert (results.runs, results.failed) == (3, 0)
    beams = results.table("beams", ["run", "position_up_m", "altitude_m", "site_from_body_w"])
    np.testing.assert_array_equal(beams["position_up_m"], beams["altitude_m"])
    assert results.table("runs").num_rows == 3
    assert set(results.table("beams").column_names) == {"run", "altitude_m", *TABLE}
    assert {band.axis for band in results.statistics()} == {"altitude_m", "true_incidence_deg"}


def test_refusals_are_one_line(campaign_file: Callable[..., Path], tmp_path: Path) -> None:
    file = campaign_file(SMALL, 3)
    for arguments, keys, line in (
        (
            (file, tmp_path),
            {"runs": 0},
            "run_campaign: runs: 0 is not usable; allowed: a whole number above 0",
        ),
        ((file, tmp_path), {"workers": 1.5}, "run_campaign: workers: 1.5"),
        ((file, tmp_path, {"timing.rate_hz": -1}), {}, "campaign: timing.rate_hz: -1 is not usable"),
        (("nosuch", tmp_path), {}, "nosuch: no such file"),
    ):
        with pytest.raises(InputError) as refused:
            run_campaign(*arguments, **keys)  # type: ignore[arg-type]
        assert str(refused.value).startswith(line)

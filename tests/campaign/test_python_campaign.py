"""A campaign from Python: the tables of the command line, and refusals in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from small_campaign import SMALL

from lidar_emu import InputError, run_campaign
from lidar_emu.cli import cli
from lidar_emu.measurement import TABLE
from lidar_emu.scenario.yaml_text import read_mapping


@pytest.mark.slow
def test_the_tables_are_those_of_the_command_line(campaign_file: Callable[..., Path], tmp_path: Path) -> None:
    file = campaign_file(SMALL, 3)
    told: list[tuple[int, int]] = []
    changes = {"timing.rate_hz": 10}
    results = run_campaign(
        file, tmp_path / "python", changes, workers=1, progress=lambda *done: told.append(done)
    )
    assert (told[0], told[-1]) == ((0, 3), (3, 3))
    options = ["--out", str(tmp_path / "cli"), "--workers", "1", "--set", "timing.rate_hz=10"]
    done = CliRunner().invoke(cli, ["campaign", str(file), *options])
    assert done.exit_code == 0, done.output
    for part in sorted((tmp_path / "cli").rglob("*.parquet")):
        same = tmp_path / "python" / part.relative_to(tmp_path / "cli")
        assert same.read_bytes() == part.read_bytes(), part
    assert (results.runs, results.failed) == (3, 0)
    beams = results.table("beams", ["run", "position_up_m", "altitude_m", "site_from_body_w"])
    np.testing.assert_array_equal(beams["position_up_m"], beams["altitude_m"])
    assert results.table("runs").num_rows == 3
    stored = {name for name in TABLE if not name.startswith("true_beam_axis")}
    assert set(results.table("beams").column_names) == {"run", "altitude_m", *stored}
    assert {band.axis for band in results.statistics()} == {"altitude_m", "true_incidence_deg"}


def test_refusals_are_one_line(campaign_file: Callable[..., Path], tmp_path: Path) -> None:
    file = campaign_file(SMALL, 3)
    for arguments, keys, line in (
        ((file, tmp_path), {"runs": 0}, "run_campaign: runs: must be a whole number above 0 (got 0)"),
        (
            (file, tmp_path),
            {"workers": 1.5},
            "run_campaign: workers: must be a whole number above 0 (got 1.5)",
        ),
        (
            (file, tmp_path, {"timing.rate_hz": -1}),
            {},
            "campaign: timing.rate_hz: must be greater than or equal to 0.001 (got -1)",
        ),
        (("nosuch", tmp_path), {}, "nosuch: no such file"),
    ):
        with pytest.raises(InputError) as refused:
            run_campaign(*arguments, **keys)  # type: ignore[arg-type]
        assert str(refused.value).startswith(line)


@pytest.mark.slow
def test_a_mapping_flies_as_its_file(campaign_file: Callable[..., Path], tmp_path: Path) -> None:
    file = campaign_file(SMALL, 2)
    run_campaign(file, tmp_path / "file", workers=1)
    run_campaign(read_mapping(file), tmp_path / "mapping", workers=1)
    parts = sorted((tmp_path / "file").rglob("*.parquet"))
    assert parts
    for part in parts:
        same = tmp_path / "mapping" / part.relative_to(tmp_path / "file")
        assert same.read_bytes() == part.read_bytes(), part


@pytest.mark.parametrize(
    "change",
    [
        {"runs": 0},
        {"runs": 1e300},
        {"colour": "red"},
        {"scenario": "nosuch"},
        {"sampling": "grid"},
        {"name": 5},
    ],
)
def test_a_mapping_is_refused_as_its_file(
    campaign_file: Callable[..., Path], tmp_path: Path, change: dict[str, object]
) -> None:
    file = campaign_file(SMALL, 3)
    stated = {**read_mapping(file), **change}
    file.write_text(json.dumps(stated))
    refused = CliRunner().invoke(cli, ["campaign", str(file), "--out", str(tmp_path / "cli")])
    assert isinstance(refused.exception, InputError)
    with pytest.raises(InputError) as error:
        run_campaign(stated, tmp_path / "python")
    assert str(error.value).removeprefix("campaign: ") == str(refused.exception).removeprefix(f"{file}: ")
    assert "\n" not in str(error.value)


def test_neither_a_path_nor_a_mapping_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^run_campaign: campaign: must be a path, the name .*\(got 3\)"):
        run_campaign(3, tmp_path)  # type: ignore[arg-type]

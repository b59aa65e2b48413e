"""The file of requirements, and the value of a run that decides for its beams."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet
from small_campaign import SMALL

from lidar_emu.campaign.requirements import (
    CampaignRequirement,
    read_requirements,
    read_run_values,
    shot_values,
)
from lidar_emu.errors import InputError

GOOD = """\
requirements:
  - id: LID-010
    text: The errors of ranges are small.
    shot: range_error_m_abs
    at_most: 0.5
    altitude_m: [2, 500]
    range_m: [2, 800]
    share: 0.99
    probability: 0.95
    confidence: 0.9
  - id: LID-020
    text: |
      A run measures
      most of its speeds.
    run: speed_valid
    at_least: 30
    probability: 0.5
    confidence: 0.5
"""


def requirement(**keys) -> CampaignRequirement:
    stated = {"id": "R1", "text": "x", "probability": 0.9, "confidence": 0.9, **keys}
    return CampaignRequirement.model_validate(stated)


def test_a_file_is_read(tmp_path):
    (tmp_path / "r.yaml").write_text(GOOD)
    errors, speeds = read_requirements(tmp_path / "r.yaml")
    assert (errors.id, errors.quantity, errors.limit, errors.sign) == ("LID-010", "range_error_m_abs", 0.5, 1)
    assert (errors.altitude_m, errors.range_m, errors.share) == ((2, 500), (2, 800), 0.99)
    assert (speeds.quantity, speeds.limit, speeds.sign, speeds.share) == ("speed_valid", 30, -1, 1)


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("id: LID-020", "id: LID-010", "requirements.1.id: must be stated once (got 'LID-010')"),
        ("id: LID-020", "id: 'LID 020'", "requirements.1.id: must be up to 100 letters, digits and _ ( "),
        ("id: LID-020", "id: 20", "requirements.1.id: must be text (a number in quotes) (got 20)"),
        ("text: The errors of ranges are small.", "text: ' '", "requirements.0.text: empty; state the"),
        ("    shot: range_error_m_abs\n", "", "requirements.0.run: no quantity, or two; state either run or shot"),
        ("run: speed_valid", "run: speed_valid\n    shot: snr_db", "requirements.1.run: no quantity, or two"),
        ("run: speed_valid", "run: speed_vald", "run: no quantity 'speed_vald'; did you mean speed_valid? known: "),
        ("run: speed_valid", "run: seed", "requirements.1.run: no quantity 'seed'; known: shots, expected, "),
        ("shot: range_error_m_abs", "shot: altitude_m", "shot: no quantity 'altitude_m'; known: range_error_m_abs, "),
        ("    at_most: 0.5\n", "", "requirements.0.at_most: no limit, or two; state either at_most or at_least"),
        ("at_most: 0.5", "at_most: 0.5\n    at_least: 0", "requirements.0.at_most: no limit, or two"),
        ("at_most: 0.5", "at_most: .inf", "requirements.0.at_most: must be a finite number (got inf)"),
        ("at_least: 30", "at_least: 30\n    share: 0.5", "requirements.1.share: a key of shots; state shot"),
        ("[2, 500]", "[500, 2]", "requirements.0.altitude_m: must be two ascending numbers (got [500, 2])"),
        ("[2, 500]", "[2]", "requirements.0.altitude_m"),
        ("share: 0.99", "share: 0", "requirements.0.share: must be greater than 0 (got 0)"),
        ("share: 0.99", "share: 99", "requirements.0.share: must be less than or equal to 1 (got 99)"),
        ("probability: 0.95", "probability: 1", "requirements.0.probability: must be less than 1 (got 1)"),
        ("confidence: 0.9", "confidence: 0.1", "requirements.0.confidence: must be greater than or equal to 0.5"),
        ("    confidence: 0.9\n", "", "requirements.0.confidence: missing; this key is required"),
        ("probability: 0.95", "probabilty: 0.95", "probabilty: no such key; did you mean requirements.0.probability?"),
        (GOOD, "requirements: []", "requirements: a list of 0; state at least 1"),
        (GOOD, "- a", "a list; state a mapping of keys to values"),
        (GOOD, "name: x", "r.yaml: "),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_reported(tmp_path, old, new, reported):
    path = tmp_path / "r.yaml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_requirements(path)
    assert reported in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_the_page_has_all_keys():
    page = (Path(__file__).resolve().parents[2] / "docs" / "requirements.md").read_text(encoding="utf-8")
    (keys,) = re.findall(r"\| key \|.*?\n\n", page, re.DOTALL)
    assert all(f"`{name}`" in keys for name in CampaignRequirement.model_fields)


def beams_of(run, error_m, altitude_m=None, fired=None):
    """Columns of beams that aim at ground 100 m away."""
    run, error_m = np.array(run, dtype=np.int64), np.array(error_m, dtype=np.float64)
    return {
        "run": run,
        "fired": np.ones(run.size, dtype=bool) if fired is None else np.array(fired),
        "altitude_m": np.full(run.size, 90.0) if altitude_m is None else np.array(altitude_m),
        "true_range_m": np.full(run.size, 128.0),
        "range_m": 128.0 + error_m,
        "range_valid": np.isfinite(error_m),
    }


@given(
    errors=st.lists(st.lists(st.integers(-6, 6) | st.just(np.nan), max_size=12), min_size=1, max_size=5),
    share=st.sampled_from([0.01, 0.07, 0.5, 0.7, 0.9, 1.0]) | st.floats(0.01, 1),
    limit=st.integers(0, 6),
    at_most=st.booleans(),
)
def test_a_run_keeps_a_limit_if_the_share_of_its_beams_does(errors, share, limit, at_most):
    run = np.repeat(np.arange(len(errors)), [len(one) for one in errors])
    side = {"at_most" if at_most else "at_least": float(limit)}
    judged = requirement(shot="range_error_m_abs", share=share, **side)
    columns = beams_of(run, [error for one in errors for error in one])
    values = shot_values(judged, columns, np.arange(len(errors)))
    for own, value in zip(errors, values, strict=True):
        magnitudes = [abs(error) for error in own if np.isfinite(error)]
        if not magnitudes:
            assert np.isnan(value)
            continue
        kept = sum(each <= limit if at_most else each >= limit for each in magnitudes)
        assert (value <= limit if at_most else value >= limit) == (kept >= share * len(magnitudes) - 1e-6)
        assert value in magnitudes


def test_seven_of_a_hundred_beams_are_seven_hundredths():
    """0.07 * 100 is 7.000000000000001."""
    columns = beams_of([0] * 100, [0.0] * 7 + [9.0] * 93)
    assert shot_values(
        requirement(shot="range_error_m_abs", share=0.07, at_most=1.0), columns, np.arange(1)
    ) == [0.0]


def test_beams_outside_the_bands_and_those_that_did_not_fire_do_not_count():
    run, altitude_m = [0, 0, 0, 0, 1], [10, 20, 30, 30, 10]
    columns = beams_of(run, [4, 1, 2, 8, 4], altitude_m, [True, True, True, False, True])
    columns["true_range_m"][1] = np.nan
    columns["range_m"][1] = np.nan
    judged = requirement(shot="range_error_m_abs", at_most=3.0, altitude_m=(20.0, 30.0))
    np.testing.assert_array_equal(shot_values(judged, columns, np.arange(2)), [2, np.nan])
    judged = requirement(shot="range_error_m_abs", at_most=3.0, range_m=(1.0, 100.0))
    assert np.isnan(shot_values(judged, columns, np.arange(2))).all()


def test_validity_counts_lost_beams():
    columns = beams_of([0] * 4 + [1] * 4, [0, 0, 0, np.nan, 0, 0, 0, 0])
    judged = requirement(shot="range_valid", at_least=1.0)
    np.testing.assert_array_equal(shot_values(judged, columns, np.arange(2)), [0, 1])


def test_values_of_a_flown_campaign(fly, tmp_path):
    """Against the tables themselves, read by pandas: run by run, in the order of the runs."""
    import pandas as pd

    fly()
    folder = tmp_path / "out"
    runs, beams = pd.read_parquet(folder / "runs"), pd.read_parquet(folder / "beams")
    judged = [
        requirement(run="range_error_m_abs_p95", at_most=1.0),
        requirement(shot="snr_db", at_least=1.0, share=0.25),
        requirement(shot="speed_error_mps_abs", at_most=1.0),
    ]
    of_run, snr, speed = read_run_values(judged, folder, 1)
    np.testing.assert_array_equal(of_run.value, runs.sort_values("run")["range_error_m_abs_p95"])
    for values in (of_run, snr, speed):
        np.testing.assert_array_equal(values.run, np.arange(12))
        np.testing.assert_array_equal(values.seed, runs.sort_values("run")["seed"])
    quarter = beams.groupby("run")["snr_db"].quantile(0.75, interpolation="lower")
    ranked = beams.groupby("run")["snr_db"].apply(
        lambda all_: all_.dropna().nlargest(-(-all_.count() // 4)).min()
    )
    np.testing.assert_array_equal(snr.value, ranked)
    assert (snr.value >= quarter).all()
    error = (beams["closing_speed_mps"] - beams["true_closing_speed_mps"]).abs().groupby(beams["run"]).max()
    np.testing.assert_array_equal(speed.value, error)


def test_runs_that_failed_have_no_value_and_those_without_beams_do_not_judge(fly, tmp_path):
    """Half of the runs draw the number of a unit that no interface has, and cannot be flown."""
    fly(text=f"beams_every: 3\n{SMALL}".replace("high: 15", "high: 31"), runs=24)
    judged = [requirement(run="shots", at_least=1.0), requirement(shot="snr_db", at_least=1.0)]
    of_run, of_shot = read_run_values(judged, tmp_path / "out", 3)
    rows = sorted(parquet.read_table(tmp_path / "out" / "runs").to_pylist(), key=lambda row: row["run"])
    failed = np.array([row["failed"] is not None for row in rows])
    assert 2 < failed.sum() < 22
    assert of_run.run.tolist() == list(range(24))
    assert of_shot.run.tolist() == list(range(0, 24, 3))
    np.testing.assert_array_equal(np.isnan(of_run.value), failed)
    np.testing.assert_array_equal(np.isnan(of_shot.value), failed[::3])
    assert 0 < failed[::3].sum() < 8

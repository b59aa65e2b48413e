"""What is drawn, against closed forms, scipy's distributions and what the samplers promise."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from lidar_emu.campaign.description import draw, truncated_quantile
from lidar_emu.errors import InputError
from lidar_emu.numerics.random_streams import SHARES, generator
from lidar_emu.scenario.campaign import Campaign
from lidar_emu.scenario.json_schema import campaign_schema

RUNS = 4096
EXPECTED = {
    "uniform": ({"low": 2.0, "high": 5.0}, stats.uniform(2, 3)),
    "normal": ({"mean": 3.0, "sigma": 0.5}, stats.norm(3, 0.5)),
    "truncated": (
        {"kind": "normal", "mean": 3.0, "sigma": 0.5, "low": 2.9, "high": 4.0},
        stats.truncnorm(-0.2, 2.0, 3.0, 0.5),
    ),
    "lognormal": ({"median": 2.0, "sigma_log": 0.3}, stats.lognorm(0.3, scale=2.0)),
    "triangular": ({"low": 1.0, "mode": 2.0, "high": 5.0}, stats.triang(0.25, 1, 4)),
}


def campaign(dispersions=None, **keys):
    given = {"name": "c", "scenario": "descent.yaml", "runs": RUNS, "dispersions": dispersions or {}, **keys}
    return Campaign.model_validate(given)


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol"])
@pytest.mark.parametrize("name", EXPECTED)
def test_distributions_are_those_of_scipy(name, sampling):
    keys, law = EXPECTED[name]
    drawn = draw(campaign({"a": {"kind": name} | keys}, sampling=sampling), "c").columns["a"]
    assert stats.kstest(drawn, law.cdf).pvalue > 0.01


def test_strata_are_those_of_scipy():
    """Bit for bit: campaigns that were drawn by scipy are continued."""
    keys = {name: {"kind": "uniform", "low": 0.0, "high": 1.0} for name in "abc"}
    columns = draw(campaign(keys, sampling="latin_hypercube", seed=3), "c").columns
    ours = stats.qmc.LatinHypercube(3, rng=generator(3, SHARES)).random(RUNS)
    np.testing.assert_array_equal(np.array(list(columns.values())), np.clip(ours.T, 2.0**-32, 1 - 2.0**-32))


@pytest.mark.parametrize(
    ("low", "high"), [(-0.2, 2), (0, 1), (-1, 0), (9, 10), (-40, -38), (-5, math.inf), (-math.inf, -2)]
)
def test_truncated_quantiles_are_those_of_scipy(low, high):
    probability = np.array([2.0**-32, *np.random.default_rng(1).random(1000), 1 - 2.0**-32])
    ours = truncated_quantile(probability, low, high)
    np.testing.assert_array_equal(ours, stats.truncnorm.ppf(probability, low, high))


@pytest.mark.parametrize("sampling", ["latin_hypercube", "sobol"])
def test_even_samplings_have_a_value_in_every_stratum(sampling):
    keys = {name: {"kind": "uniform", "low": 0.0, "high": 1.0} for name in "abc"}
    for column in draw(campaign(keys, sampling=sampling), "c").columns.values():
        assert sorted(np.floor(np.array(column) * RUNS).astype(int)) == list(range(RUNS))


def test_whole_numbers_and_choices_are_as_frequent_as_asked():
    columns = draw(
        campaign(
            {
                "a": {"kind": "integer", "low": -1, "high": 2},
                "b": {"kind": "choice", "of": ["x", "never", {"kind": "plane"}], "weights": [3, 0, 1]},
            },
            sampling="latin_hypercube",
        ),
        "c",
    ).columns
    assert {value: columns["a"].count(value) for value in (-1, 0, 1, 2)} == dict.fromkeys(
        (-1, 0, 1, 2), RUNS // 4
    )
    assert columns["b"].count("x") == 3 * RUNS // 4
    assert columns["b"].count({"kind": "plane"}) == RUNS // 4


def test_a_covariance_comes_out_as_it_went_in():
    covariance = np.array([[4.0, 1.2, 0.0], [1.2, 1.0, -0.3], [0.0, -0.3, 0.25]])
    joint = {"keys": ["a", "b", "c"], "mean": [1.0, 2.0, 3.0], "covariance": covariance.tolist()}
    drawn = np.array(list(draw(campaign(joint_normals=[joint]), "c").columns.values()))
    # The standard error of a covariance of n normal pairs.
    error = np.sqrt((covariance**2 + np.outer(np.diag(covariance), np.diag(covariance))) / RUNS)
    assert np.all(np.abs(np.cov(drawn) - covariance) < 4 * error)
    assert np.all(np.abs(drawn.mean(axis=1) - joint["mean"]) < 4 * np.sqrt(np.diag(covariance) / RUNS))


def test_correlated_keys_keep_their_own_distributions():
    keys = {name: {"kind": name} | EXPECTED[name][0] for name in ("uniform", "lognormal", "triangular")}
    matrix = [[1.0, 0.8], [0.8, 1.0]]
    reported = [{"keys": ["uniform", "lognormal"], "matrix": matrix}]
    columns = draw(campaign(keys, correlations=reported), "c").columns
    for name, column in columns.items():
        assert stats.kstest(column, EXPECTED[name][1].cdf).pvalue > 0.01
    # Of a Gaussian copula: 6/pi asin(rho/2).
    rank = stats.spearmanr(columns["uniform"], columns["lognormal"]).statistic
    assert rank == pytest.approx(6 / np.pi * np.arcsin(0.4), abs=4 / np.sqrt(RUNS))
    assert abs(stats.spearmanr(columns["uniform"], columns["triangular"]).statistic) < 4 / np.sqrt(RUNS)


@pytest.mark.parametrize("sampling", ["random", "sobol"])
def test_more_runs_begin_with_the_same_ones(sampling):
    keys = {name: {"kind": "normal", "mean": 0.0, "sigma": 1.0} for name in "ab"}
    few, many = (draw(campaign(keys, sampling=sampling, runs=runs), "c") for runs in (100, 1000))
    assert [few.values(run) for run in range(100)] == [many.values(run) for run in range(100)]


def test_runs_have_seeds_of_their_own_unless_the_seed_is_drawn():
    drawn = draw(campaign(), "c")
    assert len(set(drawn.seeds)) == RUNS
    assert drawn.values(3) == {"seed": drawn.seeds[3]}
    chosen = draw(campaign({"seed": {"kind": "choice", "of": [7]}}), "c")
    assert chosen.values(3) == {"seed": 7}


@pytest.mark.parametrize(
    "matrix", [[[1.0, 1.5], [1.5, 1.0]], [[1.0, 1.0], [1.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]]
)
def test_what_is_no_covariance_is_refused(matrix):
    joint = {"keys": ["a", "b"], "mean": [0.0, 0.0], "covariance": matrix}
    with pytest.raises(InputError, match=r"c: joint_normals\.0\.covariance: .*positive definite"):
        draw(campaign(joint_normals=[joint]), "c")


def test_every_key_is_on_the_page():
    page = (Path(__file__).parents[2] / "docs" / "campaigns.md").read_text()
    schema = campaign_schema()
    models = [schema, *schema["$defs"].values()]
    keys = {key for model in models for key in model["properties"]}
    assert [key for key in keys if f"{key}:" not in page and f"`{key}`" not in page] == []
    assert all("description" in node for model in models for node in model["properties"].values())

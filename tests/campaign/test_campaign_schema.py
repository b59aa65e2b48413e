"""The schema of campaign files for editors, against what the command takes."""

import json

import jsonschema
import pytest
from ruamel.yaml import YAML

from lidar_emu.campaign.description import read_campaign
from lidar_emu.errors import InputError
from lidar_emu.scenario.json_schema import campaign_schema
from lidar_emu.scenario.parts import shipped, shipped_names

VALIDATOR = jsonschema.Draft202012Validator(campaign_schema())
KEY = "site.surface.reflectance"
TRIANGLE = {"kind": "triangular", "low": 0.1, "mode": 0.2, "high": 0.3}
NORMAL = {"kind": "normal", "mean": 0.2, "sigma": 0.01}


@pytest.mark.parametrize("name", shipped_names("campaigns"))
def test_shipped_campaigns_are_accepted(name):
    VALIDATOR.check_schema(VALIDATOR.schema)
    VALIDATOR.validate(YAML(typ="safe", pure=True).load((shipped("campaigns") / name).read_text()))


@pytest.mark.parametrize(
    ("keys", "usable"),
    [
        ({}, True),
        ({"dispersions": {KEY: NORMAL}}, True),
        ({"dispersions": {KEY: {**NORMAL, "low": 0.1}}}, True),
        ({"dispersions": {KEY: {"kind": "choice", "of": [0.1, "x", {"a": 1}]}}}, True),
        ({"set": {"level": "spectral"}, "beams_every": 10, "sampling": "sobol"}, True),
        ({"joint_normals": [{"keys": [KEY], "mean": [0.2], "covariance": [[0.1]]}]}, True),
        ({"runs": 0}, False),
        ({"runs": "many"}, False),
        ({"run": 3}, False),
        ({"sampling": "halton"}, False),
        ({"dispersions": {KEY: {**NORMAL, "kind": "gauss"}}}, False),
        ({"dispersions": {KEY: {**NORMAL, "sigma": 0}}}, False),
        ({"dispersions": {KEY: {**NORMAL, "median": 0.2}}}, False),
        ({"dispersions": {KEY: 0.2}}, False),
        ({"correlations": [{"keys": [KEY], "matrix": [[1]]}]}, False),
    ],
)
def test_campaigns_are_judged_as_the_command_judges_them(keys, usable, tmp_path):
    tree = {"name": "x", "scenario": "descent.yaml", "runs": 3, **keys}
    path = tmp_path / "campaign.yaml"
    path.write_text(json.dumps(tree))
    assert VALIDATOR.is_valid(tree) is usable
    if usable:
        assert read_campaign(path)[1].name == "x"
    else:
        with pytest.raises(InputError):
            read_campaign(path)


@pytest.mark.parametrize(
    ("keys", "refusal"),
    [
        ({"dispersions": {KEY: {**TRIANGLE, "mode": 0.4}}}, "mode: must be from 0.1 to 0.3 (got 0.4)"),
        ({"dispersions": {KEY: {**TRIANGLE, "low": 0.2, "high": 0.2}}}, "high: must be above low, 0.2 (got 0.2)"),
        ({"dispersions": {KEY: {"kind": "choice", "of": [1, 2], "weights": [0, 0]}}}, "weights: must be 2 numbers, "),
        ({"joint_normals": [{"keys": [KEY], "mean": [], "covariance": [[1]]}]}, "mean: must be one number per key"),
        ({"correlations": [{"keys": ["a", "b"], "matrix": [[1, 0], [0.5, 1]]}]}, "must be 0, as in row 0: symmetric"),
        ({"correlations": [{"keys": ["a", "b"], "matrix": [[1], [0]]}]}, "wrong size; state 2 rows of 2 numbers"),
        ({"correlations": [{"keys": ["a", "b"], "matrix": [[1, 0], [0, 1]]}]}, "must be keys of dispersions, each in"),
    ],
)  # fmt: skip
def test_keys_that_do_not_fit_together_are_refused(keys, refusal, tmp_path):
    (tmp_path / "campaign.yaml").write_text(
        json.dumps({"name": "x", "scenario": "descent.yaml", "runs": 3, **keys})
    )
    with pytest.raises(InputError) as caught:
        read_campaign(tmp_path / "campaign.yaml")
    assert refusal in str(caught.value)

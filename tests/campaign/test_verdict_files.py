"""Verdicts as other programs read them, commands that repeat runs, and the command line."""

from __future__ import annotations

import csv
import json
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner
from small_campaign import SMALL

from lidar_emu.campaign.description import prepare
from lidar_emu.campaign.requirements import CampaignRequirement, RunValues
from lidar_emu.campaign.verdict_files import judge_campaign, junit_xml, misses_table, strictdoc
from lidar_emu.campaign.verdicts import judge
from lidar_emu.cli.campaign import campaign
from lidar_emu.cli.simulate import simulate
from lidar_emu.errors import InputError, RunError

TEXTS = {
    "LID-010": "Errors are <small> & *rare*, |mostly|; `see_ [LINK: LID-020]",
    "LID-020": "Two\n  lines, a tab\tand \x1b[31mred\x07 ]]> end",
    "LID-030": ">>> <<< UID: \N{DEGREE SIGN}C \N{GREEK SMALL LETTER SIGMA} 10\N{NO-BREAK SPACE}m",
}
PRINTED = {
    "LID-010": TEXTS["LID-010"],
    "LID-020": "Two lines, a tab and ?[31mred? ]]> end",
    "LID-030": ">>> <<< UID: \N{DEGREE SIGN}C \N{GREEK SMALL LETTER SIGMA} 10 m",
}
MISSES = {"LID-010": 0, "LID-020": 30, "LID-030": 4}
VERDICTS = {"LID-010": "pass", "LID-020": "fail", "LID-030": "not enough runs"}


@pytest.fixture
def prepared(campaign_file):
    return prepare(campaign_file(SMALL, 64), [], None)


@pytest.fixture
def judged():
    """A requirement that passes, one that fails and one without enough runs, of 64 runs."""
    return [
        judge(
            CampaignRequirement(
                id=name, text=text, run="shots", at_most=0.5, probability=0.95, confidence=0.95
            ),
            RunValues(
                np.arange(64), np.arange(64), np.array([1.0] * MISSES[name] + [0.0] * (64 - MISSES[name]))
            ),
        )
        for name, text in TEXTS.items()
    ]


# Elements of junit-10.xsd of Jenkins' xUnit plugin, which GitLab, GitHub actions and pytest follow: required and
# optional attributes, and the elements that may be below.
SCHEMA = {
    "testsuites": (set(), {"name", "time", "tests", "failures", "errors"}, {"testsuite"}),
    "testsuite": (
        {"name", "tests", "failures", "errors"},
        {"group", "time", "skipped", "timestamp", "hostname", "id", "package", "file", "log", "url"},
        {"testsuite", "properties", "testcase", "system-out", "system-err"},
    ),
    "properties": (set(), set(), {"property"}),
    "property": ({"name", "value"}, set(), set()),
    "testcase": (
        {"name"},
        {"time", "classname", "group"},
        {"skipped", "error", "failure", "system-out", "system-err"},
    ),
    "failure": (set(), {"type", "message"}, set()),
    "error": (set(), {"type", "message"}, set()),
    "system-out": (set(), set(), set()),
}
MIXED = {"failure", "error", "system-out"}


def check_element(element: ElementTree.Element) -> None:
    required, optional, below = SCHEMA[element.tag]
    assert required <= set(element.attrib) <= required | optional, element.tag
    assert element.tag in MIXED or not (element.text or "").strip()
    for child in element:
        assert child.tag in below
        assert not (child.tail or "").strip()
        check_element(child)


def test_junit_xml_is_as_ci_systems_read_it(judged, prepared):
    root = ElementTree.fromstring(junit_xml(judged, prepared).encode())
    assert root.tag == "testsuites"
    check_element(root)
    (suite,) = root
    for element in (root, suite):
        assert [element.get(name) for name in ("name", "tests", "failures", "errors")] == [
            "small",
            "3",
            "1",
            "1",
        ]
    assert {each.get("name"): each.get("value") for each in suite.iter("property")} == {
        "runs": "64", "seed": "5", "sampling": "random",
    }  # fmt: skip
    passed, failed, undecided = suite.iter("testcase")
    assert [each.get("name") for each in (passed, failed, undecided)] == [
        f"{name}: {text}" for name, text in PRINTED.items()
    ]
    assert [each.tag for case in (passed, failed, undecided) for each in case] == [
        "system-out",
        "failure",
        "error",
    ]
    assert passed[0].text.splitlines()[0] == (
        "64 of 64 runs meet it: a probability at least 0.9542 with 95 % confidence, 0.95 required"
    )
    # A lower bound of 0.05 ** (1 / 64), rounded down.
    assert 0.95425 < 0.05 ** (1 / 64) < 0.9543
    lines = failed[0].text.splitlines()
    assert lines[1] == "limit: shots at most 0.5; 1 would just pass"
    assert len([line for line in lines if line.startswith("run ")]) == 20
    assert lines[-1] == "all 30 runs that miss it are in misses.csv"
    lines = undecided[0].text.splitlines()
    # Quantiles of scipy.stats.beta: 0.86266 of (60, 5) and 0.97837 of (61, 4).
    assert lines[0].startswith(
        "60 of 64 runs meet it: a probability at least 0.8626, at most 0.9784 with 95 %"
    )
    assert lines[2].startswith("with 4 misses, 181 runs would pass; fly a new campaign under another seed")


@pytest.mark.slow
def test_strictdoc_opens_the_document(judged, prepared, tmp_path):
    program = Path(sys.executable).with_name("strictdoc")
    if not program.exists():
        pytest.skip("strictdoc is not installed")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "requirements.sdoc").write_text(strictdoc(judged, prepared), encoding="utf-8")
    command = [
        program,
        "export",
        "in",
        "--formats=json,html",
        "--no-parallelization",
        "--output-dir=out",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (document,) = json.loads((tmp_path / "out" / "json" / "index.json").read_text())["DOCUMENTS"]
    assert document["TITLE"] == "Requirements of small"
    assert {node["UID"]: node["STATUS"] for node in document["NODES"]} == VERDICTS
    assert {node["UID"]: node["STATEMENT"] for node in document["NODES"]} == PRINTED
    assert document["NODES"][1]["COMMENT"].count("lidar-emu simulate ") == 20


def test_all_misses_are_in_the_table(judged, prepared):
    rows = list(csv.DictReader(misses_table(judged, prepared).splitlines()))
    assert {(row["requirement"], int(row["run"])) for row in rows} == {
        (name, run) for name, count in MISSES.items() for run in range(count)
    }
    assert all(row["value"] == "1.0" for row in rows)


CHOICES = """\
  name: {{kind: choice, of: ["it's", "a b", "true", "1e3", "{{x: 1}}", "\\u03c3", "#"]}}
  scanner: {{kind: choice, of: [ndl_three_beam, {{pattern: {{kind: square, angle_deg: 20}}, firing: together}}]}}
"""


@pytest.mark.slow
def test_the_command_repeats_the_run(fly, tmp_path, monkeypatch):
    """Every drawn value reaches `simulate` as it was drawn, texts that YAML would read otherwise too."""
    import pandas as pd

    monkeypatch.chdir(tmp_path)
    text = SMALL + CHOICES
    fly(text=text, runs=6)
    prepared = prepare(tmp_path / "campaign.yaml", [], None)
    never = CampaignRequirement(id="R", text="x", run="shots", at_most=0.0, probability=0.9, confidence=0.9)
    judge_campaign([never], prepared, tmp_path / "out")
    beams = pd.read_parquet(tmp_path / "out" / "beams")
    with (tmp_path / "out" / "misses.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    for row in rows:
        words = shlex.split(row["command"])
        assert words[:2] == ["lidar-emu", "simulate"]
        done = CliRunner().invoke(simulate, words[2:], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        alone = pd.read_csv(f"run_{row['run']}.csv")
        own = beams[beams["run"] == int(row["run"])]
        for name in ("range_m", "closing_speed_mps", "snr_db", "true_range_m"):
            np.testing.assert_allclose(own[name], alone[name], rtol=0, atol=1e-3)


REQUIREMENTS = """\
requirements:
  - {id: R1, text: one, run: shots, at_least: 1, probability: 0.8, confidence: 0.9}
  - {id: R2, text: two, shot: snr_db, at_least: 900, probability: 0.8, confidence: 0.9}
  - {id: R3, text: three, shot: range_valid, at_least: 1, share: 0.1, probability: 0.99, confidence: 0.9}
"""


def run(*arguments):
    return CliRunner().invoke(campaign, [str(argument) for argument in arguments], catch_exceptions=True)


@pytest.mark.slow
def test_a_campaign_is_judged_by_the_command(campaign_file, tmp_path):
    out, stated = tmp_path / "out", tmp_path / "r.yaml"
    stated.write_text(REQUIREMENTS)
    command = (campaign_file(), "--out", out, "--workers", 1, "--requirements", stated)
    done = run(*command)
    assert isinstance(done.exception, RunError)
    assert str(done.exception) == "2 of 3 requirements do not pass: R2 (fail), R3 (not enough runs)"
    assert "R3 needs 230 runs, 388 with a miss, 531 with two; 12 runs cannot pass" in done.stderr
    lines = done.stdout.splitlines()
    assert lines[lines.index("R1: pass") + 1].startswith(
        "  12 of 12 runs meet it: a probability at least 0.8254 "
    )
    assert lines[lines.index("R2: fail") + 1].startswith(
        "  0 of 12 runs meet it: a probability below 0.1746 "
    )
    assert lines[-1] == f"{out}: 12 runs, 0 failed"
    files = {
        name: (out / name).read_bytes() for name in ("requirements.xml", "requirements.sdoc", "misses.csv")
    }
    again = json.loads(run(*command, "--json").stdout)
    assert {name: (out / name).read_bytes() for name in files} == files
    found = again["requirements"]
    assert [(one["id"], one["verdict"], one["runs"], one["missed"]) for one in found] == [
        ("R1", "pass", 12, 0),
        ("R2", "fail", 12, 12),
        ("R3", "not enough runs", 12, 0),
    ]
    assert found[0]["low"] == pytest.approx(0.1 ** (1 / 12))
    stated.write_text(REQUIREMENTS.splitlines(keepends=True)[0] + REQUIREMENTS.splitlines()[1])
    assert run(*command).exit_code == 0


def test_the_plan_says_how_many_runs_are_needed(campaign_file, tmp_path):
    (tmp_path / "r.yaml").write_text(REQUIREMENTS)
    path = campaign_file(f"sampling: latin_hypercube\n{SMALL}", 100)
    planned = json.loads(run(path, "--plan", "--json", "--requirements", tmp_path / "r.yaml").stdout)
    assert planned["requirements"][2] == {
        "id": "R3", "runs": 100, "least_runs": [230, 388, 531], "most_misses": -1, "failing_misses": 3,
    }  # fmt: skip
    lines = run(path, "--plan", "--requirements", tmp_path / "r.yaml").stdout.splitlines()
    assert lines[-1] == "R3 needs 230 runs, 388 with a miss, 531 with two; 100 runs cannot pass"


def test_requirements_are_read_before_a_run_is_flown(campaign_file, tmp_path):
    done = run(campaign_file(), "--out", tmp_path / "out", "--requirements", tmp_path / "missing.yaml")
    assert isinstance(done.exception, InputError)
    assert "missing.yaml: no such file" in str(done.exception)
    assert not Path(tmp_path / "out").exists()

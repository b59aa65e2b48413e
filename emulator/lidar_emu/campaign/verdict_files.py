"""Verdicts on requirements as files: JUnit XML for CI, a document of StrictDoc, and a table of the runs that miss."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from lidar_emu.campaign.description import PreparedCampaign
from lidar_emu.campaign.requirements import CampaignRequirement, read_run_values
from lidar_emu.campaign.verdicts import Judgement, Miss, RequirementVerdict, judge, least_runs
from lidar_emu.errors import one_line, printable
from lidar_emu.files import whole_file

_MISSES = "misses.csv"
_MOST_LISTED = 20
"""Most runs that a document lists of a requirement; the table has all."""


def judge_campaign(
    requirements: Sequence[CampaignRequirement], prepared: PreparedCampaign, folder: Path
) -> list[Judgement]:
    """Judge requirements by a finished campaign, and write the verdicts into its folder.

    Raises:
        InputError: a file of the campaign is damaged.
        RunError: writing failed.
    """
    values = read_run_values(requirements, folder, prepared.campaign.beams_every)
    judged = [judge(one, its) for one, its in zip(requirements, values, strict=True)]
    for name, text in (
        ("requirements.xml", junit_xml(judged, prepared)),
        ("requirements.sdoc", strictdoc(judged, prepared)),
        (_MISSES, misses_table(judged, prepared)),
    ):
        with whole_file(folder / name) as file:
            file.write(text.encode())
    return judged


def evidence(judgement: Judgement) -> list[str]:
    """What a verdict rests on, in lines."""
    requirement, misses = judgement.requirement, len(judgement.missed)
    confidence = f"with {100 * requirement.confidence:g} % confidence"
    low, high = np.floor(judgement.low * 1e4) / 1e4, np.ceil(judgement.high * 1e4) / 1e4
    shown = {
        RequirementVerdict.PASS: f"at least {low:.4f}",
        RequirementVerdict.FAIL: f"below {high:.4f}",
        RequirementVerdict.UNDECIDED: f"at least {low:.4f}, at most {high:.4f}",
    }[judgement.verdict]
    lines = [
        f"{judgement.runs - misses} of {judgement.runs} runs meet it: "
        f"a probability {shown} {confidence}, {requirement.probability:g} required"
    ]
    if judgement.bound is not None:
        side = "at least" if requirement.at_most is None else "at most"
        limit = f"{requirement.quantity} {side} {requirement.limit:g}"
        lines.append(f"limit: {limit}; {judgement.bound:.6g} would just pass")
    if judgement.verdict is RequirementVerdict.UNDECIDED:
        lines.append(
            f"with {misses} misses, {least_runs(requirement, misses)} runs would pass; fly a new campaign under "
            "another seed: runs added once a verdict is known do not have the stated confidence"
        )
    return lines


def describe_miss(miss: Miss, prepared: PreparedCampaign) -> str:
    """A run that misses a requirement, and the command that repeats it, in a line."""
    value = "no value" if miss.value is None else f"{miss.value:.6g}"
    return f"run {miss.run}, {value}: {repeat_command(miss.run, prepared)}"


def repeat_command(run: int, prepared: PreparedCampaign) -> str:
    """Command that simulates a run of a campaign again."""
    values = prepared.drawn.values(run)
    # JSON, since all of it is YAML, and a text such as "true" stays one.
    settings = (
        f"--set {quote(f'{key}={json.dumps(value)}')}"
        for key, value in prepared.base.stated(values)
        if key != "seed"
    )
    scenario = f"lidar-emu simulate {quote(prepared.base.scenario)} --seed {values['seed']}"
    return printable(" ".join([scenario, *settings, f"--out run_{run}.csv"]))


def _lines(judgement: Judgement, prepared: PreparedCampaign) -> list[str]:
    missed = judgement.missed
    rest = [f"all {len(missed)} runs that miss it are in {_MISSES}"] if len(missed) > _MOST_LISTED else []
    return [
        *evidence(judgement),
        *(describe_miss(miss, prepared) for miss in missed[:_MOST_LISTED]),
        *rest,
    ]


def _about(prepared: PreparedCampaign) -> dict[str, str]:
    campaign = prepared.campaign
    return {"runs": str(campaign.runs), "seed": str(campaign.seed), "sampling": campaign.sampling}


class JunitTest(NamedTuple):
    """A requirement as a test of JUnit."""

    judgement: Judgement
    message: str
    """Why it does not pass, in one line."""
    lines: list[str]
    """What its verdict rests on."""


class JunitSuite(NamedTuple):
    """Requirements that are judged together."""

    name: str
    properties: dict[str, str]
    tests: list[JunitTest]


def junit_xml(judged: Sequence[Judgement], prepared: PreparedCampaign) -> str:
    """JUnit XML as CI systems read it: a test per requirement; a lack of runs is an error."""
    tests = [JunitTest(one, evidence(one)[0], _lines(one, prepared)) for one in judged]
    name = one_line(prepared.campaign.name)
    return junit_text(name, [JunitSuite(name, _about(prepared), tests)])


def junit_text(name: str, suites: Sequence[JunitSuite]) -> str:
    """JUnit XML of suites: a test that fails is a failure, one that lacks runs an error."""
    counts = _junit_counts(name, [test for suite in suites for test in suite.tests])
    root = ElementTree.Element("testsuites", counts)
    for suite in suites:
        element = ElementTree.SubElement(root, "testsuite", _junit_counts(suite.name, suite.tests))
        if suite.properties:
            properties = ElementTree.SubElement(element, "properties")
            for key, value in suite.properties.items():
                ElementTree.SubElement(properties, "property", name=key, value=value)
        for test in suite.tests:
            requirement, verdict = test.judgement.requirement, test.judgement.verdict
            title = f"{requirement.id}: {one_line(requirement.text)}"
            case = ElementTree.SubElement(element, "testcase", classname=suite.name, name=title)
            if verdict is RequirementVerdict.PASS:
                found = ElementTree.SubElement(case, "system-out")
            else:
                tag = "failure" if verdict is RequirementVerdict.FAIL else "error"
                found = ElementTree.SubElement(case, tag, type=verdict, message=test.message)
            found.text = "\n".join(test.lines)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _junit_counts(name: str, tests: Sequence[JunitTest]) -> dict[str, str]:
    verdicts = [test.judgement.verdict for test in tests]
    return {
        "name": name,
        "tests": str(len(tests)),
        "failures": str(verdicts.count(RequirementVerdict.FAIL)),
        "errors": str(verdicts.count(RequirementVerdict.UNDECIDED)),
    }


def strictdoc(judged: Sequence[Judgement], prepared: PreparedCampaign) -> str:
    """A document of StrictDoc: a requirement each, with its verdict as status and what that rests on as comment."""
    about = "".join(f"\n  {key}: {value}" for key, value in _about(prepared).items())
    # Markup is off: names of quantities contain underscores, which are links in reStructuredText.
    head = f"[DOCUMENT]\nTITLE: Requirements of {one_line(prepared.campaign.name)}\nOPTIONS:\n  MARKUP: Text"
    nodes = (
        f"[REQUIREMENT]\nUID: {one.requirement.id}\nSTATUS: {one.verdict}\n"
        f"STATEMENT: {one_line(one.requirement.text)}\n"
        "COMMENT: >>>\n" + "\n".join([*_lines(one, prepared), "<<<\n"])
        for one in judged
    )
    return "\n".join([f"{head}\nMETADATA:{about}\n", *nodes])


def misses_table(judged: Sequence[Judgement], prepared: PreparedCampaign) -> str:
    """CSV table of all runs that miss a requirement, the worst first, each with the command that repeats it."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["requirement", "run", "seed", "value", "command"])
    writer.writerows(
        (one.requirement.id, *miss, repeat_command(miss.run, prepared))
        for one in judged
        for miss in one.missed
    )
    return text.getvalue()

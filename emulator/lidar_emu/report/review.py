"""The report's chapter for a review: what stands behind a run, in the order of NASA-STD-7009A's credibility factors.

It states evidence and what is missing, with the command that makes it. Levels of credibility are for the reviewer.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from importlib.resources import files

from lidar_emu.plan import Plan
from lidar_emu.recording.read import mapping_of
from lidar_emu.report.evidence import COMMANDS, Evidence
from lidar_emu.report.html_parts import heading, html_table, note
from lidar_emu.report.recorded_run import RecordedRun

_NOT_VALIDATED = (
    "Not validated: no flight of the modelled instrument with a truth of its own was available. Published figures hold "
    "single effects against others' measurements, not this scenario; links were tried on virtual buses and emulated "
    "adapters. Ground, trajectory and faults are the scenario's, as it states them."
)


def review_chapter(run: RecordedRun, plan: Plan | None, evidence: Sequence[Evidence]) -> list[str]:
    """The chapter as HTML elements.

    Args:
        run: the recorded run.
        plan: its plan; None: it cannot be determined here.
        evidence: results of other commands.
    """
    return [
        heading("For the review"),
        note(
            "In the order of the credibility factors of NASA-STD-7009A; what is missing is named with its command. "
            "Levels are not assigned."
        ),
        heading("Data pedigree", 3),
        html_table(("input", "SHA-256"), _hashes(run)),
        heading("Verification", 3),
        *_stages(plan),
        *_results("accuracy", "This scenario against level reference", evidence),
        heading("Validation", 3),
        note("Laws, figures and data by others, as of this version."),
        html_table(
            ("figure", "source", "scene", "quantity", "published", "emulator", "verdict"), published_rows()
        ),
        *_results("fit", "A sensor's log", evidence),
        note(_NOT_VALIDATED),
        heading("Input pedigree", 3),
        note(
            "Every key with the value that it had is under Scenario and instrument, at the end of this page."
        ),
        heading("Uncertainty characterization", 3),
        note("The run's errors beside those expected are in the summary at the top."),
        *_results("budget", "One measurement by source", evidence),
        heading("Results robustness", 3),
        *_results("sensitivity", "What matters", evidence),
        heading("Results against requirements", 3),
        *_results("requirements", "Requirements", evidence),
        heading("History and management", 3),
        html_table((), run.recording.of_origin("build", mapping_of).items()),
        note(
            f"Seed {run.recording.scenario.seed}. lidar-emu replay {run.recording.path.name} --recompute computes the "
            "run again and compares it packet by packet."
        ),
    ]


def published_rows() -> list[list[str]]:
    """Published experiments as this version reproduces them: rows of `docs/evidence/published.md`."""
    text = (files("lidar_emu") / "shipped" / "published.csv").read_text()
    return list(csv.reader(io.StringIO(text)))[1:]


def _hashes(run: RecordedRun) -> list[tuple[str, str]]:
    origin, named = run.recording.origin, run.recording.of_origin("files_sha256", mapping_of)
    own = {name: origin[f"{name}_sha256"] for name in ("scenario", "interface")}
    # A shipped file is named within the package, wherever that was installed.
    return [(name.rpartition("lidar_emu/shipped/")[2], digest) for name, digest in (own | named).items()]


def _stages(plan: Plan | None) -> list[str]:
    if plan is None:
        return [note("The stages cannot be determined here: a file of the scenario is missing.")]
    rows = (
        (d.stage, "yes" if d.computed else "left out", d.how, d.reason, d.limits)
        for d in sorted(plan.decisions, key=lambda d: d.computed)
    )
    return [
        heading("Stages computed and left out", 4),
        html_table(("stage", "computed", "how", "reason", "bound"), rows),
    ]


def _results(kind: str, title: str, evidence: Sequence[Evidence]) -> list[str]:
    found = [each for each in evidence if each.kind == kind]
    if not found:
        return [note(f"{title}: not given ({COMMANDS[kind]}; then --evidence FILE).")]
    return [
        part
        for each in found
        for part in (heading(f"{title}: {each.title}", 4), html_table(each.heads, each.rows))
    ]

"""The HTML report of a recorded run: summary, figures, events and the review in one self-contained file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any

from lidar_emu.files import whole_file
from lidar_emu.plan import Plan
from lidar_emu.report.evidence import Evidence
from lidar_emu.report.html_parts import heading, html_table, note, page_document
from lidar_emu.report.recorded_run import RecordedRun
from lidar_emu.report.review import review_chapter

_LABEL_WIDTH = 11
"""Width of the label in a line of the summary."""
_ROWS = 50


def write_page(
    path: Path,
    run: RecordedRun,
    summary: Sequence[str],
    figures: Sequence[str],
    notes: Sequence[str],
    plan: Plan | None,
    evidence: Sequence[Evidence] = (),
) -> None:
    """Write the page.

    Args:
        path: file.
        run: the recorded run.
        summary: lines, each with a label in its first eleven columns.
        figures: figures as `figure_element` renders them, in order.
        notes: missing figures, with the reasons.
        plan: plan of the run; None: it cannot be determined here.
        evidence: results of other commands, for the review.

    Raises:
        InputError: the file cannot be written.
        RunError: writing failed.
    """
    first = (
        1 if run.is_flight else 0
    )  # a flight's page begins with its path, as a map and in three dimensions
    parts = [
        f"<h1>{escape(run.name)}</h1>",
        note(run.recording.path.name),
        *figures[:first],
        html_table((), ((line[:_LABEL_WIDTH].strip(), line[_LABEL_WIDTH:]) for line in summary if line)),
        *figures[first:],
        *map(note, notes),
        *_events(run),
        *review_chapter(run, plan, evidence),
        *_scenario(run),
    ]
    with whole_file(path) as file:
        file.write(page_document(run.name, parts).encode())


def _events(run: RecordedRun) -> list[str]:
    rows: list[tuple[float, str, str]] = [
        *(
            (each.time_ns, f"command {each.values['command']}", _command(each.values))
            for each in run.commands
        ),
        *(
            (each.time_ns, "fault injected", _fault(each.values["definition"]))
            for each in run.injected_faults
        ),
        *((each.time_ns, str(each.values["of"]), str(each.values["what"])) for each in run.events),
    ]
    if not rows:
        return []
    rows.sort()
    shown = [(f"{time_ns * 1e-9:.3f}", what, how) for time_ns, what, how in rows[:_ROWS]]
    more = [note(f"and {len(rows) - _ROWS} more")] if len(rows) > _ROWS else []
    return [
        heading("Commands, injected faults, events"),
        html_table(("time (s)", "event", "details"), shown),
        *more,
    ]


def _command(values: dict[str, Any]) -> str:
    arguments = " ".join(f"{name}={value}" for name, value in values["values"].items())
    return f"{arguments} {str(values['verdict']).replace('_', ' ')}".strip()


def _fault(definition: dict[str, Any]) -> str:
    return " ".join(f"{name}={value}" for name, value in definition.items() if value is not None)


def _scenario(run: RecordedRun) -> list[str]:
    tree = run.recording.of_origin("scenario", json.loads)
    instrument = tree.pop("instrument", None)
    parts = {"Scenario": tree} | ({} if instrument is None else {"Instrument": {"instrument": instrument}})
    shown = (
        f"<details><summary>{title}</summary><pre>{escape(_as_yaml(values))}</pre></details>"
        for title, values in parts.items()
    )
    about = note("Every key with the value it had in this run, defaults included.")
    return [heading("Scenario and instrument"), about, *shown]


def _as_yaml(values: dict[str, Any]) -> str:
    from ruamel.yaml import YAML

    text = StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style, yaml.sort_base_mapping_type_on_output = False, False  # type: ignore[assignment]
    yaml.width = 100
    yaml.dump(values, text)
    return text.getvalue()

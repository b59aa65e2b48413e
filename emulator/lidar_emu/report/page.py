"""The HTML report of a recorded run: summary, figures, events, plan and origin in one self-contained file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any

from lidar_emu.files import whole_file
from lidar_emu.plan import Plan
from lidar_emu.recording.read import mapping_of
from lidar_emu.report.plot_style import Drawing, as_svg
from lidar_emu.report.recorded_run import RecordedRun

_LABEL_WIDTH = 11
"""Width of the label in a line of the summary."""
_ROWS = 50
_STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1f2328; --faint: #6a727d; --rule: #d6dae0; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #14171b; --ink: #dde1e6; --faint: #9aa2ad; --rule: #363c45; }
}
body { margin: 2rem auto; max-width: 62rem; padding: 0 1rem; background: var(--paper); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin-bottom: 0.2rem; }
h2 { font-size: 1.15rem; margin-top: 2.4rem; border-bottom: 1px solid var(--rule); }
figure { margin: 0.8rem 0; overflow-x: auto; }
figure svg { width: 100%; min-width: 40rem; height: auto; color: var(--ink); }
svg text { font-family: system-ui, sans-serif !important; }
figcaption, .note { color: var(--faint); font-size: 0.88rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.88rem; }
th { text-align: left; font-weight: 600; }
td, th { padding: 0.15rem 0.9rem 0.15rem 0; vertical-align: top; border-bottom: 1px solid var(--rule);
  overflow-wrap: anywhere; }
summary { cursor: pointer; font-weight: 600; }
pre { font-size: 0.8rem; line-height: 1.35; overflow-x: auto; }
thead th { white-space: nowrap; overflow-wrap: normal; }
tbody th { min-width: 6rem; max-width: 16rem; }
"""
_NOTHING_FROM_OUTSIDE = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def write_page(
    path: Path,
    run: RecordedRun,
    summary: Sequence[str],
    figures: Sequence[str],
    notes: Sequence[str],
    plan: Plan | None,
) -> None:
    """Write the page.

    Args:
        path: file.
        run: the recorded run.
        summary: lines, each with a label in its first eleven columns.
        figures: figures as `figure_element` renders them, in order.
        notes: missing figures, with the reasons.
        plan: plan of the run; None: it cannot be determined here.

    Raises:
        InputError: the file cannot be written.
        RunError: writing failed.
    """
    parts = [
        f"<h1>{escape(run.name)}</h1>",
        f'<p class="note">{escape(run.recording.path.name)}</p>',
        html_table((), ((line[:_LABEL_WIDTH].strip(), line[_LABEL_WIDTH:]) for line in summary if line)),
        *figures,
        *(f'<p class="note">{escape(note)}</p>' for note in notes),
        *_events(run),
        *_left_out(plan),
        *_scenario(run),
        "<h2>Origin</h2>",
        html_table((), _origin(run)),
    ]
    with whole_file(path) as file:
        file.write(page_document(run.name, parts).encode())


def page_document(title: str, parts: Iterable[str]) -> str:
    """A self-contained page of HTML elements, which loads nothing from outside."""
    body = "\n".join(parts)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_NOTHING_FROM_OUTSIDE}">
<link rel="icon" href="data:,">
<title>{escape(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
{body}
</body>
</html>
"""


def figure_element(drawing: Drawing) -> str:
    """Render a figure with its heading and caption."""
    svg = as_svg(drawing).replace("<svg", f'<svg role="img" aria-label="{escape(drawing.description)}"', 1)
    return (
        f'<h2>{escape(drawing.title)}</h2>\n<figure id="{drawing.name}">{svg}'
        f"<figcaption>{escape(drawing.description)}</figcaption></figure>"
    )


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
    more = [f'<p class="note">and {len(rows) - _ROWS} more</p>'] if len(rows) > _ROWS else []
    return [
        "<h2>Commands, injected faults, events</h2>",
        html_table(("time (s)", "event", "details"), shown),
        *more,
    ]


def _command(values: dict[str, Any]) -> str:
    arguments = " ".join(f"{name}={value}" for name, value in values["values"].items())
    return f"{arguments} {str(values['verdict']).replace('_', ' ')}".strip()


def _fault(definition: dict[str, Any]) -> str:
    return " ".join(f"{name}={value}" for name, value in definition.items() if value is not None)


def _left_out(plan: Plan | None) -> list[str]:
    if plan is None:
        return []
    rows = (
        (d.stage, "yes" if d.computed else "left out", d.how, d.reason, d.limits)
        for d in sorted(plan.decisions, key=lambda d: d.computed)
    )
    heads = ("stage", "computed", "how", "reason", "bound")
    return ["<h2>Stages computed and left out</h2>", html_table(heads, rows)]


def _scenario(run: RecordedRun) -> list[str]:
    tree = run.recording.of_origin("scenario", json.loads)
    instrument = tree.pop("instrument", None)
    parts = {"Scenario": tree} | ({} if instrument is None else {"Instrument": {"instrument": instrument}})
    note = '<p class="note">Every key with the value it had in this run, defaults included.</p>'
    shown = (
        f"<details><summary>{title}</summary><pre>{escape(_as_yaml(values))}</pre></details>"
        for title, values in parts.items()
    )
    return ["<h2>Scenario and instrument</h2>", note, *shown]


def _as_yaml(values: dict[str, Any]) -> str:
    from ruamel.yaml import YAML

    text = StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style, yaml.sort_base_mapping_type_on_output = False, False  # type: ignore[assignment]
    yaml.width = 100
    yaml.dump(values, text)
    return text.getvalue()


def _origin(run: RecordedRun) -> list[tuple[str, str]]:
    origin = run.recording.origin
    build, named = (run.recording.of_origin(key, mapping_of) for key in ("build", "files_sha256"))
    hashes = {name: origin[f"{name}_sha256"] for name in ("scenario", "interface")} | named
    return [*build.items(), *((name, f"SHA-256 {value}") for name, value in hashes.items())]


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of texts; the first cell of a row is its heading."""
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heads)
    body = "\n".join(
        f'<tr><th scope="row">{escape(first)}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in rest)
        + "</tr>"
        for first, *rest in rows
    )
    begin = f"<thead><tr>{head}</tr></thead>" if heads else ""
    return f'<div class="wide"><table>{begin}<tbody>\n{body}\n</tbody></table></div>'

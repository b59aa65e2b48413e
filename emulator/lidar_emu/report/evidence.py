"""Results of other commands as tables for the review of a run."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from lidar_emu.errors import Finding, InputError, listed
from lidar_emu.files import read_bytes

_MOST_BYTES = 64 << 20
COMMANDS = {
    "accuracy": "lidar-emu bench accuracy SCENARIO --json > accuracy.json",
    "fit": "lidar-emu fit LOG --json > fit.json",
    "budget": "lidar-emu budget SCENARIO --at ALTITUDE --json > budget.json",
    "sensitivity": "lidar-emu campaign CAMPAIGN --out DIR --sensitivity, DIR/sensitivity.csv",
    "requirements": "lidar-emu campaign CAMPAIGN --out DIR --requirements FILE, DIR/requirements.xml",
}
"""What makes each kind of results."""
_ERRORS = {"range_m": "range_error_m", "speed_mps": "speed_error_mps"}
"""Keys of a sheet's contributions, and of the errors that they combine to."""


class Evidence(NamedTuple):
    """Results of one command."""

    kind: str
    """A key of `COMMANDS`."""
    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


def read_evidence(path: Path) -> Evidence:
    """Read a file of results.

    Raises:
        InputError: the file cannot be read, or is none of `COMMANDS`.
    """
    data = read_bytes(path, _MOST_BYTES, "must be a file of results")
    for read in (_from_json, _from_junit, _from_indices):
        try:
            found = read(data.decode(), path.name)
        except (ValueError, KeyError, TypeError, AttributeError, ElementTree.ParseError):
            continue
        if found is not None:
            return found
    remedy = f"must be one of: {listed(COMMANDS.values())}"
    raise InputError("--evidence", None, Finding(f"no results in {path}"), remedy)


def _from_json(text: str, name: str) -> Evidence | None:
    tree = json.loads(text)
    readers: dict[str, tuple[str, Callable[[dict[str, Any], str], Evidence]]] = {
        "settings": ("reference", _accuracy),
        "checks": ("figures", _fit),
        "sources": ("range_error_m", _budget),
    }
    for key, (other, read) in readers.items():
        if key in tree and other in tree:
            return read(tree, name)
    return None


def _accuracy(tree: dict[str, Any], name: str) -> Evidence:
    columns = {
        "range_error_m": "range (m)",
        "speed_error_mps": "speed (m/s)",
        "outcome_error": "outcomes",
        "faster_than_reference": "times faster",
    }
    rows = [[row["name"], *_numbers(row, columns)] for row in tree["settings"]]
    about = f"{tree['scenario']} against level {tree['reference']}, {tree['shots']} shots; {name}"
    return Evidence("accuracy", about, ("setting", *columns.values()), rows)


def _fit(tree: dict[str, Any], name: str) -> Evidence:
    columns = {"value": "value", "low": "from", "high": "to"}
    rows = [
        [each["what"], *_numbers(each, columns), each["unit"], "inside" if each["inside"] else "outside"]
        for each in tree["checks"]
    ]
    about = f"held-out half of {tree['log']}, {tree['shots']} shots, against its {tree['reference']}; {name}"
    return Evidence("fit", about, ("quantity", *columns.values(), "unit", "90 % band"), rows)


def _budget(tree: dict[str, Any], name: str) -> Evidence:
    rows = [
        [
            each["name"],
            "yes" if each["on"] else "no, typical size",
            each["type"],
            each["law"],
            *_numbers({key: each[key]["uncertainty"] for key in _ERRORS}, _ERRORS),
        ]
        for each in tree["sources"]
    ]
    for percent in ("68", "95"):
        widths = {key: tree[error][f"half_width_{percent}"] for key, error in _ERRORS.items()}
        factors = ", ".join(f"{tree[error][f'coverage_factor_{percent}']:.2f}" for error in _ERRORS.values())
        rows.append([f"all, {percent} % half-width", "", "", f"k {factors}", *_numbers(widths, _ERRORS)])
    about = f"beam {tree['beam']} of {tree['scenario']} at {tree['altitude_m']:.5g} m; {name}"
    heads = ("source", "in the scenario", "type", "distribution", "range (m)", "speed (m/s)")
    return Evidence("budget", about, heads, rows)


def _from_junit(text: str, name: str) -> Evidence | None:
    root = ElementTree.fromstring(text)
    rows = []
    for case in root.iter("testcase"):
        found = next((each for each in case if each.tag in ("failure", "error")), None)
        verdict = "pass" if found is None else str(found.get("type"))
        said = case.findtext("system-out", "") if found is None else str(found.text)
        rows.append([case.attrib["name"], verdict, said.strip().partition("\n")[0]])
    return Evidence("requirements", name, ("requirement", "verdict", "by"), rows) if rows else None


def _from_indices(text: str, name: str) -> Evidence | None:
    shares = ("first", "first_low", "first_high", "total", "total_low", "total_high")
    rows = [
        [
            f"{row['output']}: {row['factor']}",
            *(f"{float(row[key]):.3f}" if row[key] else "" for key in shares),
        ]
        for row in csv.DictReader(io.StringIO(text))
        if not row["low_m"]
    ]
    heads = ("output: source", "first", "from", "to", "total", "from", "to")
    return Evidence("sensitivity", f"Sobol indices of whole flights; {name}", heads, rows) if rows else None


def _numbers(row: Mapping[str, Any], keys: Mapping[str, str]) -> list[str]:
    return ["" if row[key] is None else f"{row[key]:.4g}" for key in keys]

"""The report's chapter for a review, from the files that other commands write, and from files that are none."""

from __future__ import annotations

import csv
import json
import re
import subprocess
from html import unescape
from pathlib import Path

import pytest
from installed_programs import LIDAR_EMU

from lidar_emu.errors import InputError
from lidar_emu.report.evidence import COMMANDS, read_evidence
from lidar_emu.report.review import published_rows

PAGE = Path(__file__).parents[2] / "docs" / "evidence" / "published.md"
CAMPAIGN = """
name: small
scenario: descent.yaml
runs: {runs}
seed: 1
set: {{level: geometric, duration_s: 0.5}}
dispersions: {{site.surface.reflectance: {{kind: uniform, low: 0.1, high: 0.3}}}}
"""
REQUIREMENTS = """
requirements:
- {id: LID-1, text: Ranges are <true>, run: shots, at_least: 1, probability: 0.8, confidence: 0.8}
"""
FACTORS = [
    "Data pedigree", "Verification", "Validation", "Input pedigree", "Uncertainty characterization",
    "Results robustness", "Results against requirements", "History and management",
]  # fmt: skip


def texts(page: Path) -> str:
    return unescape(re.sub(r"<[^>]+>", "\n", page.read_text().replace("<wbr>", "")))


@pytest.mark.slow
def test_the_page_shows_what_the_commands_found(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(CAMPAIGN.format(runs=64))
    (tmp_path / "r.yaml").write_text(REQUIREMENTS)

    def run(*arguments: str) -> str:
        command = [LIDAR_EMU, *arguments]
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    run("campaign", "c.yaml", "--out", "judged", "--requirements", "r.yaml")
    run("campaign", "c.yaml", "--out", "sources", "--sensitivity")
    run("simulate", "descent.yaml", "--set", "duration_s=8", "--out", "log.csv")
    for name, command in {
        "fit": ["fit", "log.csv"],
        "accuracy": ["bench", "accuracy", "descent.yaml", "--shots", "12"],
        "budget": ["budget", "descent.yaml", "--at", "500"],
    }.items():
        (tmp_path / f"{name}.json").write_text(run(*command, "--json"))
    run("run", "descent.yaml", "--set", "duration_s=1", "--pace", "max", "--record", "flight.mcap")
    found = ["fit.json", "accuracy.json", "budget.json", "judged/requirements.xml", "sources/sensitivity.csv"]
    evidence = [word for name in found for word in ("--evidence", name)]
    run("report", "flight.mcap", "--html", "with.html", *evidence)
    run("report", "flight.mcap", "--html", "without.html")

    full, bare = texts(tmp_path / "with.html"), texts(tmp_path / "without.html")
    places = [full.index(f"\n{factor}\n") for factor in FACTORS]
    assert places == sorted(places)
    assert "not given" not in full
    assert "\nground/mare.npz\n" in full
    assert all(f"({command}; then --evidence FILE)" in bare for command in COMMANDS.values())
    assert "LID-1: Ranges are <true>\n" in full
    fit = json.loads((tmp_path / "fit.json").read_text())
    assert all(check["what"] in full for check in fit["checks"])
    budget = json.loads((tmp_path / "budget.json").read_text())
    assert all(f"\n{source['name']}\n" in full for source in budget["sources"])
    assert f"\n{budget['range_error_m']['half_width_95']:.4g}\n" in full
    with (tmp_path / "sources" / "sensitivity.csv").open() as file:
        flights = [row for row in csv.DictReader(file) if not row["low_m"]]
    assert all(f"{row['output']}: {row['factor']}" in full for row in flights)


def test_the_published_rows_are_those_of_the_page() -> None:
    table = PAGE.read_text().split("<!-- published: begin -->")[1].split("<!-- published: end -->")[0]
    cells = [
        [cell.strip(" *`") for cell in line[1:-1].split("|")] for line in table.splitlines() if "|" in line
    ]
    assert published_rows() == cells[2:]
    assert len({row[0] for row in published_rows()} - {""}) >= 10


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\x00\xff", b"{}", b"[1]", b"null", b'{"checks": 1, "figures": 2}', b"a,b\n1,2\n", b"<testsuites/>",
        b"<a", b'{"settings": [{}], "reference": "r"}',
        b'{"sources": [{}], "range_error_m": {}}',
    ],
)  # fmt: skip
def test_a_file_of_something_else_is_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "evidence"
    path.write_bytes(data)
    with pytest.raises(InputError, match="no results in"):
        read_evidence(path)

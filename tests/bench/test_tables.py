"""`benchmarks.tables` writes tables between the markers of pages; CI stores the ratio of every benchmark."""

from __future__ import annotations

import json
import sys
from importlib import import_module
from pathlib import Path
from runpy import run_path

import pytest

from benchmarks import performance, tables
from lidar_emu.cli.bench import bench


def test_only_the_text_between_the_markers_changes(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- t: begin -->\nold\n<!-- t: end -->\nafter\n")
    for text in ("first", "second"):
        tables.update(page, "t", text)
    assert page.read_text() == "before\n<!-- t: begin -->\nsecond\n<!-- t: end -->\nafter\n"


def test_parts_become_tables_and_paragraphs(capsys: pytest.CaptureFixture[str]) -> None:
    parts = ["said first", ("", "us"), ("one", "1"), ("two", "2"), "then", ("x",), ("3",), "", "said last"]
    text = tables.markdown(parts)
    assert text.splitlines() == [
        "said first", "", "|  | us |", "|---|---|", "| one | 1 |", "| two | 2 |", "", "then", "", "| x |", "|---|",
        "| 3 |", "", "said last",
    ]  # fmt: skip
    assert capsys.readouterr().out == text + "\n"


@pytest.mark.parametrize(
    ("shots", "fast_times", "said"), [(30, 0, "30 measurements a row"), (30, 10, "300 of the others")]
)
def test_counts_are_said_below_a_table(
    shots: int, fast_times: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(performance, "ratio_parts", lambda count: [("a",), (str(count),)])
    table = tables.Table("page.md", "performance", "1 s", 100, fast_times, "ratio_parts")
    *rows, last = tables.parts_of(table, shots)
    assert rows == [("a",), ("30",)]
    assert said in last


@pytest.mark.parametrize("name", tables.TABLES)
def test_every_table_has_its_place_and_its_maker(name: str) -> None:
    table = tables.TABLES[name]
    text = (tables.DOCS / table.page).read_text()
    assert text.count(f"<!-- {name}: begin -->") == text.count(f"<!-- {name}: end -->") == 1
    assert callable(getattr(import_module(f"benchmarks.{table.module}"), table.function))


def test_every_command_with_a_ratio_is_recorded() -> None:
    commands = {
        module[-1] for module, _, _ in performance.BENCHES.values() if module[:2] == ["lidar_emu", "bench"]
    }
    assert commands == set(bench.commands) - {"accuracy", "stability"}


MODULES = sorted(Path(tables.__file__).parent.glob("*.py"))
SCRIPTS = [path for path in MODULES if "__main__" in path.read_text()]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_scripts_have_help_and_refuse_what_they_do_not_know(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for option, code in (("--help", 0), ("--unknown", 2)):
        monkeypatch.setattr(sys, "argv", [path.name, option])
        with pytest.raises(SystemExit) as ended:
            run_path(str(path), run_name="__main__")
        assert ended.value.code == code
    assert "python -m benchmarks." in capsys.readouterr().out


@pytest.mark.slow
def test_a_ratio_is_read_from_what_a_benchmark_prints(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(performance, "BENCHES", {"protocol": (["benchmarks.protocol"], [], [])})
    performance.main(tmp_path / "new" / "ratios.json")
    written = json.loads((tmp_path / "new" / "ratios.json").read_text())["ratios"]["protocol"]
    assert written["ratio"] > 0.0
    assert written["of"].startswith("time of an encoder in C to ours")

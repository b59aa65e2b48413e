"""Print the size of the project beside the limits and goals of budget.toml. Exit code 1: over a limit."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import click

ROOT = Path(__file__).resolve().parents[1]
GENERATED = {"api.md", "columns.md", "scenario-reference.md"}
NOT_FOR_USERS = {"decisions", "evidence", "reference"}


def main() -> int:
    """Compare each count with its limit and its goal."""
    budget = tomllib.loads((ROOT / "budget.toml").read_text(encoding="utf-8"))
    counts = counted(ROOT)
    assert counts.keys() == budget.keys(), "budget.toml and tools/budget.py name different numbers"
    for name, count in counts.items():
        limit, goal = budget[name]["limit"], budget[name].get("goal", count)
        note = f"  goal {goal}, {count - goal} to go" if count > goal else ""
        if count > limit:
            note += f"  OVER by {count - limit}: {budget[name]['why']}"
        print(f"{name:14}{count:8} of {limit:6}{note}")
    print(f"{'evidence_words':14}{words(pages(ROOT / 'docs' / 'evidence')):8} without a limit")
    return int(any(count > budget[name]["limit"] for name, count in counts.items()))


def counted(root: Path) -> dict[str, int]:
    """All that has a limit."""
    product = sources(root / "emulator", root / "protocol")
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = list(commands())
    return {
        "product_lines": lines(product),
        "product_files": len(product),
        "test_lines": lines(sources(root / "tests")),
        "tool_lines": lines(sources(root / "tools", root / "benchmarks")),
        "page_words": words([root / "README.md", *user_pages(root / "docs")]),
        "keys": sum(keys(_text(page)) for page in pages(root / "docs" / "reference")),
        "commands": len(found),
        "options": sum(isinstance(each, click.Option) for command in found for each in command.params),
        "extras": len(project["optional-dependencies"]),
    }


def sources(*folders: Path) -> list[Path]:
    """All Python files below folders."""
    return [path for folder in folders for path in folder.rglob("*.py")]


def lines(paths: Iterable[Path]) -> int:
    """Lines of files, blank ones too."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def pages(folder: Path) -> list[Path]:
    """Pages and notebooks below a folder."""
    return [*folder.rglob("*.md"), *folder.rglob("*.ipynb")]


def user_pages(docs: Path) -> list[Path]:
    """Pages that people write for users."""
    return [
        path
        for path in pages(docs)
        if path.name not in GENERATED and NOT_FOR_USERS.isdisjoint(path.relative_to(docs).parts)
    ]


def words(paths: Iterable[Path]) -> int:
    """Words as `wc -w` counts them; of a notebook, those of its cells."""
    return sum(len(_text(path).split()) for path in paths)


def _text(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".ipynb":
        return text
    cells: list[dict[str, Any]] = json.loads(text)["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells)


def keys(reference: str) -> int:
    """Rows of the tables of keys."""
    tables = re.findall(r"^\| key \|.*\n\|[-|]+\n((?:\|.*\n)+)", reference, re.MULTILINE)
    return sum(table.count("\n") for table in tables)


def commands() -> Iterator[click.Command]:
    """Every command of the program, those of groups included."""
    from lidar_emu.cli import cli

    def below(command: click.Command) -> Iterator[click.Command]:
        if not isinstance(command, click.Group):
            yield command
            return
        context = click.Context(command)
        for name in command.list_commands(context):
            found = command.get_command(context, name)
            assert found is not None
            yield from below(found)

    return below(cli)


if __name__ == "__main__":
    sys.exit(main())

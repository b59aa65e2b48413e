"""Every command and every Python block of a page runs as printed, in the order of the page."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from printed_blocks import NOT_YET, PAGES, ROOT, Block, blocks, needs
from terminals import Terminals

RUN = [page for page in PAGES if str(page.relative_to(ROOT)) not in NOT_YET]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_block_is_recognised(page: Path) -> None:
    blocks(page)


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN, ids=name)
def test_a_page_runs_as_printed(page: Path, tmp_path: Path) -> None:
    for part in ("examples", "protocol", "tools"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    at_root = page.is_relative_to(ROOT / "docs") or page.parent == ROOT
    folder = tmp_path if at_root else tmp_path / page.parent.relative_to(ROOT)
    for block in blocks(page):
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif not block.left_out:
            run(block, folder)


def run(block: Block, folder: Path) -> None:
    if block.language == "python":
        done = subprocess.run(
            [sys.executable, "-c", block.text], cwd=folder, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, f"line {block.line}:\n{done.stderr[-2000:]}"
        return
    with Terminals(folder) as terminals:
        for command in block.commands:
            if needs(command) is None:
                terminals.type(command)

"""Every command and every Python block of a page runs as printed, in the order of the page.

The Python blocks of a page are one session: names of an earlier block are there in a later one.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from installed_programs import with_programs
from printed_blocks import PAGES, ROOT, Block, blocks, needs
from terminals import Terminals
from twins import write_haworth, write_jezero
from waiting import LIMIT_S

# Maps that a page tells its reader to download, replaced by synthetic ones of the same format.
DOWNLOADS = {
    "Haworth_final_adj_5mpp_surf.tif": write_haworth,
    "DTEEC_045994_1985_046060_1985_U01.IMG": write_jezero,
}
# The environment that `make run` makes, where .ci/run has made it: a command of README that needs more fails.
AS_README_INSTALLS = ROOT / "build" / "readme-venv" / "bin"


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def folder_of(page: Path) -> Path:
    """Folder in which the commands of a page work, in a clone."""
    return Path() if page.is_relative_to(ROOT / "docs") else page.parent.relative_to(ROOT)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_block_is_recognised(page: Path) -> None:
    blocks(page)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_target_of_make_exists(page: Path) -> None:
    for block in blocks(page):
        for command in block.commands:
            if block.language == "sh" and command.startswith("make "):
                dry = command.replace("make ", "make --dry-run ", 1)
                subprocess.run(
                    ["bash", "-c", dry],
                    cwd=ROOT / folder_of(page),
                    check=True,
                    capture_output=True,
                    timeout=LIMIT_S,
                )


SHOWN = [block for block in blocks(ROOT / "docs" / "cookbook.md") if block.text.startswith("$ ")]


@pytest.mark.parametrize("block", SHOWN, ids=lambda block: f"line {block.line}")
def test_the_cookbook_shows_what_is_printed(block: Block, tmp_path: Path) -> None:
    """Lines of the page's output, in order; `...` stands for others."""
    output = block.text.replace("\\\n", "").splitlines()
    lines = [line for line in output if not line.startswith("$ ") and line.strip() != "..."]
    command = ["bash", "-c", "\n".join(block.commands)]
    done = subprocess.run(
        command, cwd=tmp_path, env=with_programs(COLUMNS="80"), stdout=-1, text=True, check=True
    )
    printed = iter(done.stdout.splitlines())
    assert [line for line in lines if line not in printed] == []
    assert lines


@pytest.fixture
def port_5600(page: Path) -> Iterator[None]:
    """Keep the port of the examples and of live truth for one page at a time: pages may be tested side by side."""
    if not re.search(r"5600|\blive", page.read_text(encoding="utf-8")):
        yield
        return
    with FileLock(Path(tempfile.gettempdir()) / "lidar-emu-port-5600.lock"):
        yield


@pytest.mark.slow
@pytest.mark.usefixtures("port_5600")
@pytest.mark.parametrize("page", PAGES, ids=name)
def test_a_page_runs_as_printed(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for part in ("benchmarks", "docs", "examples", "protocol", "tools"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    folder = tmp_path / folder_of(page)
    monkeypatch.chdir(folder)
    for file, write in DOWNLOADS.items():
        if file in page.read_text(encoding="utf-8"):
            write(Path(file))
    names: dict[str, Any] = {"__name__": "__main__"}
    activated = AS_README_INSTALLS if page == PAGES[0] and AS_README_INSTALLS.exists() else None
    for block in blocks(page):
        if block.file:
            Path(block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "python" and not block.left_out:
            exec(compile("\n" * (block.line - 1) + block.text, page, "exec"), names)
        elif not block.left_out:
            with Terminals(folder, activated) as terminals:
                for command in block.commands:
                    if needs(command) is None:
                        terminals.type(command)

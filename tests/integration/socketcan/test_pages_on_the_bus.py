"""Commands that pages print for vcan0, typed as printed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from printed_blocks import PAGES, ROOT, Block, blocks, needs
from terminals import Terminals


def on_the_bus(block: Block) -> list[str]:
    if block.language != "sh" or block.left_out:
        return []
    return [command for command in block.commands if needs(command) == "vcan0"]


PAGES_ON_THE_BUS = [page for page in PAGES if any(map(on_the_bus, blocks(page)))]


@pytest.mark.parametrize("page", PAGES_ON_THE_BUS, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_on_vcan0_run_as_printed(page: Path, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "protocol", tmp_path / "protocol")
    for block in blocks(page):
        with Terminals(tmp_path) as terminals:
            for command in on_the_bus(block):
                terminals.type(command)

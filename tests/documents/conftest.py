"""The printed count of blocks that run, and of those left out by each mark."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import pytest

sys.path.insert(
    0, str(Path(__file__).parent)
)  # printed_blocks.py and terminals.py are modules of these tests

from printed_blocks import NOT_YET, PAGES, ROOT, blocks, needs


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    reports = [report for kind in ("passed", "failed") for report in terminalreporter.stats.get(kind, [])]
    if not any("documents/test_pages" in report.nodeid for report in reports):
        return
    counted: Counter[str] = Counter()
    for page in PAGES:
        for block in blocks(page):
            if str(page.relative_to(ROOT)) in NOT_YET:
                counted["on a page not covered yet"] += 1
            elif block.left_out or block.language != "sh":
                counted[block.left_out or "run"] += 1
            else:
                counted.update(
                    f"needs: {need}" if (need := needs(line)) else "run" for line in block.commands
                )
    terminalreporter.section("commands and blocks of the pages")
    for kind, count in counted.most_common():
        terminalreporter.line(f"{count:4d}  {kind}")

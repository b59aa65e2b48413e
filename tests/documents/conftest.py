"""The printed count of blocks that run, and of those left out by each mark."""

from __future__ import annotations

from collections import Counter

import pytest
from printed_blocks import PAGES, blocks, needs


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    reports = [report for kind in ("passed", "failed") for report in terminalreporter.stats.get(kind, [])]
    if not any("documents/test_pages" in report.nodeid for report in reports):
        return
    counted: Counter[str] = Counter()
    for page in PAGES:
        for block in blocks(page):
            if block.left_out or block.language != "sh":
                counted[block.left_out or "run"] += 1
            else:
                counted.update(
                    f"needs: {need}" if (need := needs(line)) else "run" for line in block.commands
                )
    terminalreporter.section("commands and blocks of the pages")
    for kind, count in counted.most_common():
        terminalreporter.line(f"{count:4d}  {kind}")

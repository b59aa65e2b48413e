"""Which tests may be skipped: `tests/allowed_skips.txt`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import pytest

LIST = Path(__file__).resolve().parents[1] / "allowed_skips.txt"
IN_CI = "LIDAR_EMU_CI" in os.environ


class AllowedSkip(NamedTuple):
    """A line of the list."""

    where: str
    tests: str
    reason: str
    why: str


def allowed_skips() -> list[AllowedSkip]:
    """All lines of the list."""
    lines = [line for line in LIST.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return [AllowedSkip(*(part.strip() for part in line.split("|"))) for line in lines]


def is_allowed(test: str, reason: str, in_ci: bool = IN_CI) -> bool:
    """Whether a test, by its path from the root, may be skipped for a reason."""
    return any(
        test.startswith(each.tests) and each.reason in reason and not (in_ci and each.where == "developer")
        for each in allowed_skips()
    )


def fail_unless_allowed(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Make a skip that the list does not allow a failure."""
    if report.skipped and isinstance(report.longrepr, tuple):
        reason = report.longrepr[2].removeprefix("Skipped: ")
        if not is_allowed(report.nodeid, reason):
            report.outcome = "failed"
            report.longrepr = f"may not be skipped by {LIST.name}: {reason}"

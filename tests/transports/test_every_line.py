"""Every kind of line, in memory, on ptys and between two processes, held to the same."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # far_ends.py and lines.py are modules of these tests

from far_ends import LINES, FarEnd
from lines import EveryLine, InAnother, InThisProcess, Place, closing

IN_ONE_PROCESS = {"loopback", "virtual"}
CASES = [pytest.param((InThisProcess, line), id=f"{line}-in this process") for line in LINES] + [
    pytest.param((InAnother, line), id=f"{line}-in another", marks=pytest.mark.slow)
    for line in LINES
    if line not in IN_ONE_PROCESS
]


@pytest.mark.filterwarnings(r"ignore:set\w+\(\) is deprecated:DeprecationWarning")  # of pyserial's own
class TestEveryLine(EveryLine):
    @pytest.fixture(params=CASES)
    def case(self, request: pytest.FixtureRequest) -> Any:
        return request.param

    @pytest.fixture
    def place(self, case: tuple[Place, str]) -> Place:
        return case[0]

    @pytest.fixture
    def far(self, case: tuple[Place, str], tmp_path: Path) -> Iterator[FarEnd]:
        if case[1] == "remote":
            pytest.importorskip("can_remote", reason="python-can-remote is not installed")
        yield from closing(LINES[case[1]](tmp_path))

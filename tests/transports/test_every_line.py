"""Every kind of line, in memory, on ptys and between two processes, held to the same."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # far_ends.py and lines.py are modules of these tests

import far_ends
from far_ends import FarEnd
from lines import EveryLine, InAnother, InThisProcess, Place, closing

LINES: dict[str, Callable[[Path], FarEnd]] = {
    "loopback": lambda _: far_ends.Loopback(),
    "pty": lambda _: far_ends.Pty(),
    "serial": far_ends.Serial,
    "socket": lambda _: far_ends.Socket(),
    "rfc2217": lambda _: far_ends.Telnet(),
    "udp": lambda _: far_ends.Udp(),
    "udp6": lambda _: far_ends.Udp("::1"),
    "slcan": far_ends.Slcan,
    "virtual": lambda _: far_ends.Virtual(),
    "remote": lambda _: far_ends.Remote(),
}


IN_ONE_PROCESS = {"loopback", "virtual"}
CASES = [(InThisProcess, line) for line in LINES] + [
    (InAnother, line) for line in LINES if line not in IN_ONE_PROCESS
]


@pytest.mark.filterwarnings(r"ignore:set\w+\(\) is deprecated:DeprecationWarning")  # of pyserial's own
class TestEveryLine(EveryLine):
    @pytest.fixture(params=CASES, ids=lambda case: f"{case[1]}-{case[0].__name__}")
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

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
from lines import EveryLine, InAnother, InThisProcess, closing

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
}


@pytest.mark.filterwarnings(r"ignore:set\w+\(\) is deprecated:DeprecationWarning")  # of pyserial's own
class TestEveryLine(EveryLine):
    @pytest.fixture(params=LINES)
    def far(self, request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[FarEnd]:
        yield from closing(LINES[request.param](tmp_path))

    @pytest.fixture(params=[InThisProcess, InAnother])
    def place(self, request: pytest.FixtureRequest, far: FarEnd) -> Any:
        if request.param is InAnother and far.one_process:
            pytest.skip("it ends with its process")
        return request.param

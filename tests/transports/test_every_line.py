"""Every kind of line, in memory, on ptys and between two processes, held to the same."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # far_ends.py and lines.py are modules of these tests

from far_ends import LINES, FarEnd, Telnet
from lines import EveryLine, InAnother, InThisProcess, Place, closing
from waiting import eventually

from lidar_emu.transports.serial_port import open_byte_channel

PYSERIAL_WARNS = pytest.mark.filterwarnings(r"ignore:set\w+\(\) is deprecated:DeprecationWarning")
IN_ONE_PROCESS = {"loopback", "virtual"}
CASES = [pytest.param((InThisProcess, line), id=f"{line}-in this process") for line in LINES] + [
    pytest.param((InAnother, line), id=f"{line}-in another", marks=pytest.mark.slow)
    for line in LINES
    if line not in IN_ONE_PROCESS
]


@PYSERIAL_WARNS
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


@PYSERIAL_WARNS
@pytest.mark.parametrize(
    ("serial_format", "parity", "stop_bits"), [("", "N", 1), ("8E1", "E", 1), ("8O2", "O", 2)]
)
def test_parity_and_stop_bits_reach_the_line(serial_format: str, parity: str, stop_bits: int) -> None:
    """As a terminal server is told them: the kernel's ptys have neither."""
    server = Telnet()
    channel = open_byte_channel(replace(server.spec, baud=57600, serial_format=serial_format))
    eventually(lambda: server.line_settings() == (57600, parity, stop_bits))
    channel.close()
    server.disconnect()

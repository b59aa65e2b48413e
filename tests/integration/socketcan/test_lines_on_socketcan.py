"""What every line has to do, on SocketCAN: a far end that goes takes the interface down. And UDP as tshark sees it."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "transports"))

from can_tools import ended_at_the_end
from far_ends import Bus, FarEnd
from lines import EveryLine, InAnother, InThisProcess, closing
from programs import Program
from waiting import eventually

from lidar_emu.transports.can_adapters import enlarge_receive_buffer

Start = Callable[..., Program]
PORT = 5600


class SocketCan(Bus):
    reports_loss = True

    def __init__(self) -> None:
        super().__init__("socketcan", "vcan0")

    def disconnect(self) -> None:
        super().disconnect()
        self._set("down")

    def reconnect(self) -> None:
        self._set("up")
        super().reconnect()
        enlarge_receive_buffer(self._bus.socket)  # what it loses would look like the device's tearing

    def close(self) -> None:
        super().close()
        self._set("up")

    def _set(self, state: str) -> None:
        subprocess.run(["ip", "link", "set", "vcan0", state], check=True)


class TestSocketCan(EveryLine):
    @pytest.fixture
    def far(self) -> Iterator[FarEnd]:
        yield from closing(SocketCan())

    @pytest.fixture(params=[InThisProcess, InAnother])
    def place(self, request: pytest.FixtureRequest) -> Any:
        return request.param

    @pytest.fixture
    def eventually(self) -> Any:
        return eventually


def test_udp_as_tshark_dissects_it(start: Start, tmp_path: Path) -> None:
    reported = tmp_path / "tshark.txt"
    fields = ["-T", "fields", "-e", "ip.dst", "-e", "udp.dstport", "-e", "udp.length"]
    with reported.open("wb") as out, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", PORT))
        command = ["tshark", "-l", "-Q", "-i", "lo", "-f", f"udp dst port {PORT}", *fields]
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.DEVNULL)
        with ended_at_the_end(process):
            run = start("run", "bench.yaml", "--port", f"udp:{PORT}")
            received = [host.recv(2000) for _ in range(60)]
            eventually(lambda: reported.read_text().count("\n") >= 20)
            run.end()
    lines = reported.read_text().splitlines()[:20]
    assert {line.split("\t")[0] for line in lines} == {"127.0.0.1"}
    # The length counts the header of 8 bytes.
    assert {int(line.split("\t")[2]) for line in lines} <= {8 + len(data) for data in received}

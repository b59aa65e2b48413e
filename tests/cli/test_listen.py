"""The end of `lidar-emu listen`: a signal ends it after what it has received is shown."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
from click.testing import CliRunner
from waiting import LIMIT_S

from lidar_emu.cli import messages as message_lines
from lidar_emu.cli.listen import listen
from lidar_emu.transports import opening as host
from lidar_protocol import Message

GOLDEN = json.loads((Path(__file__).parents[1] / "protocol" / "golden.json").read_text(encoding="utf-8"))
ARRIVED = b"".join(bytes.fromhex(shot["frame"]) for shot in GOLDEN)


class Host:
    """A host that receives all golden packets in each read."""

    description = "golden packets"
    times_lost = 0

    def read(self, _timeout_s: float) -> bytes:
        return ARRIVED

    def close(self) -> None:
        pass


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_a_line_is_printed_loses_no_shot(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def json_lines(message: Message) -> Iterable[str]:
        while pending:
            signal.raise_signal(pending.pop())
        return original(message)

    original, pending = message_lines.json_lines, [number]
    monkeypatch.setattr(message_lines, "json_lines", json_lines)
    monkeypatch.setattr(host, "open_host", lambda _: Host())
    result = CliRunner().invoke(listen, ["--port", "pty", "--json"])
    assert result.exit_code == 0
    assert re.search(rf"messages {len(GOLDEN)}\b", result.stderr)
    assert [json.loads(line)["beam"] for line in result.stdout.splitlines()] == [
        beam for shot in GOLDEN for beam in range(len(shot["beams"]))
    ]


@pytest.mark.parametrize("output", ["a closed pipe", "/dev/full"])
def test_an_output_that_nobody_sees_ends_it(output: str) -> None:
    """As of `lidar-emu listen | head -1`; packets arrive without end."""
    program = (
        "import sys; from test_listen import Host; from lidar_emu.cli import main; "
        "from lidar_emu.transports import opening; opening.open_host = lambda _: Host(); "
        "sys.argv[1:] = ['listen', '--port', 'pty', '--plain']; main()"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    reading, writing = os.pipe()
    os.close(reading)
    if output == "/dev/full":
        os.dup2(os.open(output, os.O_WRONLY), writing)
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, stdout=writing, stderr=subprocess.PIPE, timeout=LIMIT_S)
    os.close(writing)
    assert b"received: " in done.stderr
    assert done.returncode == (output == "/dev/full")
    assert (b"standard output: No space left on device" in done.stderr) == (output == "/dev/full")

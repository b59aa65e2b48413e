"""The end of `lidar-emu listen`: a signal ends it after what it has received is shown."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterable
from pathlib import Path

import pytest
from click.testing import CliRunner

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

"""A recording that was cut short in the hands of the mcap library."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from programs import Program
from waiting import eventually

from lidar_emu.measurement import Measurement

PAGE = Path(__file__).resolve().parents[2] / "docs" / "recordings.md"
SHOT = b'"range_m":['

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]


def test_a_recording_that_was_cut_by_kill_9_opens_as_its_page_reports(
    start: Start, simulated: Simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = tmp_path / "flight.mcap"
    run = start("run", "descent.yaml", "--record", "flight.mcap")
    eventually(lambda: flight.exists() and flight.read_bytes().count(SHOT) > 20)
    run.process.kill()
    run.wait()
    with pytest.raises(McapError), flight.open("rb") as stream:
        list(make_reader(stream).iter_messages())
    (snippet,) = (code for code in PAGE.read_text().split("```") if "NonSeekingReader" in code)
    monkeypatch.chdir(tmp_path)
    reported: dict[str, Any] = {}
    exec(snippet.removeprefix("python\n"), reported)
    shots = [message["shot"][0] for message in reported["messages"]]
    assert len(shots) > 20
    expected = simulated("descent.yaml")
    assert shots == expected.shot[: len(shots)].tolist()
    ranges_m = np.array([message["range_m"] for message in reported["messages"]], dtype=np.float64)
    np.testing.assert_array_equal(ranges_m, expected.range_m[: len(shots)])

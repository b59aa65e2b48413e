"""A run on CAN through python-can's slcan, and programs at the other end of the bus."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from comparison import assert_complete, assert_equal
from programs import LONG_BENCH, FarEnd, Program, listened_beams, read_summary
from slcan_lines import CORE_EXACT, CORE_HELD, CORE_STEPS, FULL_EXACT, FULL_HELD, FULL_STEPS
from waiting import eventually

from lidar_emu.measurement import Measurement

BEAMS = 4

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]


def slcan(path: str, *options: str) -> list[str]:
    return ["-i", "slcan", "-c", path, "--bitrate", "1000000", *options]


@pytest.mark.parametrize("can_set", ["core", "full"])
def test_listen_at_the_other_end_of_the_bus(
    can_set: str, start: Start, far_end: FarEnd, other_end: FarEnd, simulated: Simulated, tmp_path: Path
) -> None:
    listener = start("listen", *slcan(other_end.path), "--json")
    listener.word_after("listening on ")
    far_end.deliver_to(other_end)
    # A core set does not carry the number of its shot, so on a busy machine none may be skipped as late.
    settings = ["--set", f"wire.can_messages={can_set}", "--set", "timing.late_after_s=60"]
    options = ["--duration", "2", *settings, "--summary", "s.json"]
    start("run", "descent.yaml", *slcan(far_end.path), *options).succeed()
    summary = read_summary(tmp_path / "s.json")
    count = BEAMS * summary["shots"]["sent"]
    eventually(lambda: len(listened_beams(listener)) >= count)
    listener.signal(signal.SIGINT)
    assert listener.wait() == 0
    rows = listened_beams(listener)
    if can_set == "full":
        assert_complete(rows, summary, BEAMS)
        assert_equal(rows, simulated("descent.yaml"), FULL_STEPS, FULL_HELD, FULL_EXACT)
    else:
        assert summary["shots"]["sent"] == summary["shots"]["due"], "without numbers all must be there"
        numbered = [{**row, "shot": k // BEAMS} for k, row in enumerate(rows)]
        assert_complete(numbered, summary, BEAMS)
        assert_equal(numbered, simulated("descent.yaml"), CORE_STEPS, CORE_HELD, CORE_EXACT)


@pytest.mark.slow
def test_listen_and_send_by_slcan(start: Start, far_end: FarEnd, other_end: FarEnd, tmp_path: Path) -> None:
    """An adapter has one host: one after the other, each receives what the device sends meanwhile."""
    far_end.deliver_to(other_end)
    other_end.deliver_to(far_end)
    standby = ["--set", "wire.unit=3", "--set", "device.start=standby"]
    unit = [*standby, "--set", "device.housekeeping_rate_hz=10"]
    run = start("run", *LONG_BENCH, *slcan(far_end.path), *unit, "--summary", "s.json")
    eventually(lambda: b"t1F9" in far_end.data)
    send = start(
        "send", *slcan(other_end.path), "--unit", "3", "set_mode", "mode=track", "set_mode", "mode=fault"
    )
    assert send.wait() == 1, send.err
    assert send.out == "set_mode mode=track: accepted\nset_mode mode=fault: out of range\n"
    eventually(lambda: b"t1C0" in far_end.data)
    listener = start("listen", *slcan(other_end.path), "--count", "20")
    assert listener.wait() == 0
    run.signal(signal.SIGINT)
    run.succeed()
    for value in ("mode=track", "interlock_closed=yes laser_on=yes"):  # perhaps after a first mode=acquire
        assert value in listener.out
    assert len(re.findall(r"^ *[\d.]+  3 +\d+ ", listener.out, re.MULTILINE)) == 20
    assert "acknowledgements" not in listener.err, "they were the other host's"
    commands = read_summary(tmp_path / "s.json")["commands"]
    assert (commands["accepted"], commands["rejected"]) == (2, {"out_of_range": 1})

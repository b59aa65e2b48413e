"""Two minutes at 100 shots a second with everything recorded: nothing grows. `pytest -m soak`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from programs import FarEnd, Program, read_summary
from waiting import eventually

Start = Callable[..., Program]
RATE_HZ, DURATION_S, PACKET_BYTES = 100, 120, 145
ALLOWED_KB = 1024
SLOWLY = "[{altitude_m: 1500, speed_mps: 5}, {altitude_m: 500, speed_mps: 5}]"


def resident_kb(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))


@pytest.mark.soak
def test_memory_stays(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    flight = ["descent.yaml", "--set", f"timing.rate_hz={RATE_HZ}", "--set", f"trajectory.waypoints={SLOWLY}"]
    run = start("run", *flight, "--duration", str(DURATION_S), "--port", far_end.path, "--baud", "921600",
                "--record", "r.mcap", "--summary", "s.json")  # fmt: skip
    both = run.process.pid, run.port_process()
    packets = RATE_HZ * DURATION_S
    far_end.wait_for(packets // 4 * PACKET_BYTES)
    early_kb = [resident_kb(pid) for pid in both]
    eventually(lambda: len(far_end.data) >= (packets - RATE_HZ) * PACKET_BYTES, limit_s=2 * DURATION_S)
    late_kb = [resident_kb(pid) for pid in both]
    run.succeed()
    assert all(late - early < ALLOWED_KB for early, late in zip(early_kb, late_kb, strict=True))
    summary = read_summary(tmp_path / "s.json")
    assert summary["shots"]["sent"] + summary["shots"]["late"] == packets

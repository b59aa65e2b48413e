"""The device's clock by PTP: `ptp4l` of linuxptp between two kernels, each with a clock that is not this machine's."""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from free_ports import free_udp_port
from installed_programs import with_programs

HERE = Path(__file__).parent
MACHINE = HERE / "socketcan" / "machine"
EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
S = 10**9
AHEAD_S = 86400
MASTER = f"date -s '+{AHEAD_S} seconds' && exec ptp4l -2 -S -q -i eth0 --masterOnly 1"
MISSING = [tool for tool in ("linux.uml", "ptp4l", "busybox", "ip", "cc") if shutil.which(tool) is None]


@contextmanager
def machine(ports: tuple[int, int], *command: str) -> Iterator[subprocess.Popen[str]]:
    """A kernel whose network card sends to the second port of this machine, and receives at the first."""
    network = f"eth0=ucast,,127.0.0.1,{ports[0]},{ports[1]}"
    programs = with_programs(MACHINE_NET=network)
    with subprocess.Popen(
        [MACHINE, *command], env=programs, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True
    ) as kernel:
        try:
            yield kernel
        finally:
            kernel.terminate()


@pytest.mark.slow
@pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}")
def test_time_stamps_are_the_masters_and_the_lock_is_lost_when_it_dies() -> None:
    ports, packets, housekeeping = (free_udp_port(), free_udp_port()), list[dict[str, Any]](), list[bool]()
    unit = [sys.executable, str(HERE / "ptp_unit.py"), EPOCH.isoformat(), "10"]
    with machine(ports, "bash", "-c", MASTER) as master, machine(ports[::-1], *unit) as kernel:
        assert kernel.stdout is not None
        for line in kernel.stdout:
            seen = json.loads(line)
            if "housekeeping" in seen:
                housekeeping.append(seen["housekeeping"])
                continue
            packets.append({**seen, "here_ns": time.time_ns()})
            if seen["locked"] and housekeeping[-1:] == [True]:
                master.terminate()
        assert kernel.wait() == 0
    locked = [packet["locked"] for packet in packets]
    assert [value for value, _ in itertools.groupby(locked)] == [False, True, False]
    assert {False, True} == set(housekeeping)

    epoch_ns = round(EPOCH.timestamp()) * S
    days = [round((each["time_ns"] + epoch_ns - each["here_ns"]) / (AHEAD_S * S)) for each in packets]
    assert (days[0], {day for day, is_locked in zip(days, locked, strict=True) if is_locked}) == (0, {1})
    assert all(each["time_ns"] + epoch_ns <= each["utc_ns"] for each in packets), "valid before it arrives"
    steps_ns = [
        later["time_ns"] - earlier["time_ns"] - (later["shot"] - earlier["shot"]) * S // 10
        for earlier, later in itertools.pairwise(packets)
    ]
    (step_ns,) = [step_ns for step_ns in steps_ns if abs(step_ns) > S // 1000]
    assert step_ns == pytest.approx(AHEAD_S * S, abs=AHEAD_S * S / 2)

"""Yamcs, with the ground station of examples/yamcs, shows what was simulated, and commands the lidar."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from comparison import CODES, FLAGS, SERIAL_STEPS, assert_equal
from free_ports import free_tcp_port
from waiting import eventually
from yamcs import IS_INSTALLED, ground_station, raw_of, value_of

from lidar_emu import Measurement

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not IS_INSTALLED, reason="not installed: pip install 'lidar-emu[yamcs]'"),
]
OF_BEAM = (*FLAGS, *CODES, *SERIAL_STEPS)


@contextmanager
def emulator(*arguments: str) -> Iterator[int]:
    """An emulator that waits for the ground station at a port."""
    port = free_tcp_port()
    command = [sys.executable, "-m", "lidar_emu", *arguments, "--port", f"tcp:{port}"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        try:
            yield port
        finally:
            process.terminate()


def test_a_whole_recorded_descent(recorded: Path, simulated: Measurement, tmp_path: Path) -> None:
    replayed = "replay", str(recorded / "run.mcap"), "--speed", "25"
    with emulator(*replayed) as port, ground_station(port, free_tcp_port(), tmp_path) as yamcs:
        eventually(lambda: yamcs.packets() >= len(simulated) + 1)
        names = [f"{name}_{beam}" for name in OF_BEAM for beam in range(4)]
        eventually(lambda: len(yamcs.archived(["shot"])) == len(simulated))
        shots = yamcs.archived(["shot", *names])
    rows = []
    for shot in shots:
        for beam in range(4):
            own = {name: shot[f"{name}_{beam}"] for name in OF_BEAM}
            values = {name: raw_of(each) if name in CODES else value_of(each) for name, each in own.items()}
            rows.append({"shot": raw_of(shot["shot"]), "beam": beam, **values})
    assert len(rows) == 4 * len(simulated)
    assert_equal(rows, simulated)


def test_commands_reach_the_lidar_and_a_damaged_packet_no_screen(tmp_path: Path) -> None:
    """Shots 10 to 13 have a wrong CRC. The first command halves the rate, the second one is refused."""
    damage = "faults=[{kind: wrong_crc, from_s: 0.5, to_s: 0.7}]"
    run = "run", "descent.yaml", "--set", damage, "--set", "wire.unit=3"
    with emulator(*run) as port, ground_station(port, free_tcp_port(), tmp_path, "--unit", "3") as yamcs:
        eventually(lambda: (yamcs.latest("shot") or 0) > 20)
        assert set(range(16)) - {raw_of(each["shot"]) for each in yamcs.archived(["shot"])} == {
            10,
            11,
            12,
            13,
        }
        yamcs.send("set_rate_hz", unit=3, rate_hz=10)
        eventually(lambda: yamcs.latest("acknowledge_verdict") == "accepted")
        assert yamcs.latest("acknowledge_command") == "set_rate_hz"
        yamcs.send("set_mode", unit=3, mode="self_test")
        eventually(lambda: yamcs.latest("acknowledge_command") == "set_mode")
        assert yamcs.latest("acknowledge_verdict") == "out_of_state"
        assert yamcs.latest("acknowledge_sequence") == 1
        eventually(lambda: yamcs.latest("housekeeping_commands_accepted") == 1)

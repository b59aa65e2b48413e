"""Yamcs, with the ground station of examples/yamcs, shows what was simulated, and commands the lidar."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from comparison import CODES, FLAGS, SERIAL_STEPS, assert_equal
from free_ports import free_tcp_port
from waiting import eventually
from yamcs import IS_INSTALLED, Yamcs, ground_station, raw_of, value_of

from lidar_emu import Measurement
from lidar_icd.example import BEAMS, HEADER
from lidar_protocol import Device, default_interface

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not IS_INSTALLED, reason="not installed: pip install '.[yamcs]'"),
]
OF_SHOT = ("shot", "mode", "beam_count", "time_ns")
OF_BEAM = (*FLAGS, *CODES, *SERIAL_STEPS, "time_offset_s")
Parameters = dict[str, dict[str, Any]]


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


def beams_of(yamcs: Yamcs) -> Iterator[tuple[Parameters, list[Parameters]]]:
    """For each shot, the parameters of the header, and those of each beam."""
    for shot in yamcs.archived([*OF_SHOT, *(f"{name}_{beam}" for name in OF_BEAM for beam in range(4))]):
        yield shot, [{name: shot[f"{name}_{beam}"] for name in OF_BEAM} for beam in range(4)]


def inverted(frame: bytes, bit: int) -> bytes:
    """A frame with one bit inverted."""
    changed = bytearray(frame)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def test_a_whole_recorded_descent(recorded: Path, simulated: Measurement, tmp_path: Path) -> None:
    replayed = "replay", str(recorded / "run.mcap"), "--speed", "max", "--wait-limit", "900"
    with emulator(*replayed) as port, ground_station(port, free_tcp_port(), tmp_path) as yamcs:
        eventually(lambda: yamcs.packets() >= len(simulated) + 1)
        eventually(lambda: len(yamcs.archived(["shot"])) == len(simulated))
        shots = list(beams_of(yamcs))
        modes = [value_of(each["housekeeping_mode"]) for each in yamcs.archived(["housekeeping_mode"])]
    assert modes[1:]
    assert set(modes[1:]) == {"track"}
    rows = []
    for shot, beams in shots:
        for beam, own in enumerate(beams):
            values = {name: raw_of(own[name]) if name in CODES else value_of(own[name]) for name in OF_BEAM}
            rows.append({"shot": raw_of(shot["shot"]), "beam": beam, **values})
    assert len(rows) == 4 * len(simulated)
    assert_equal(rows, simulated)
    assert {(value_of(shot["mode"]), raw_of(shot["beam_count"])) for shot, _ in shots} == {("track", 4)}
    assert {value_of(own["time_offset_s"]) for _, beams in shots for own in beams} == {0.0}
    times_ns = [value_of(shot["time_ns"]) for shot, _ in shots]
    assert times_ns == pytest.approx(simulated.time_ns[:, 0], rel=0, abs=60)


def test_a_packet_has_as_many_beams_as_its_length_says(tmp_path: Path) -> None:
    """One with a wrong bit is no packet."""
    device, counts = Device(default_interface()), [1, 4, 64, 2]
    frames = [
        device.serial_bytes({**HEADER, "shot": shot}, [BEAMS[beam % len(BEAMS)] for beam in range(count)])
        for shot, count in enumerate(counts)
    ]
    whole = device.serial_bytes({**HEADER, "shot": 101}, BEAMS)
    damaged = [inverted(whole, bit) for bit in range(0, 8 * len(whole), 13)]
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        ground_station(server.getsockname()[1], free_tcp_port(), tmp_path) as yamcs,
    ):
        connection, _ = server.accept()
        with connection:
            connection.sendall(b"".join([*damaged, *frames]))
            eventually(lambda: len(yamcs.archived(["shot"])) == len(counts))
            shots = yamcs.archived(["shot", *(f"range_m_{beam}" for beam in range(64))])
    found = {raw_of(shot.pop("shot")): [value_of(each) for each in shot.values()] for shot in shots}
    ranges_m = [pytest.approx(BEAMS[beam % len(BEAMS)]["range_m"]) for beam in range(64)]
    assert found == {shot: ranges_m[:count] for shot, count in enumerate(counts)}


def test_commands_reach_the_lidar_and_a_damaged_packet_no_screen(tmp_path: Path) -> None:
    """Shots 10 to 13 have a wrong CRC. The first command halves the rate, the second one is refused."""
    damage = "faults=[{kind: wrong_crc, from_s: 0.5, to_s: 0.7}]"
    # However long Yamcs takes to start, and the test, the flight begins with it and lasts longer.
    slow = "trajectory.waypoints=[{altitude_m: 2000, speed_mps: 1}, {altitude_m: 200, speed_mps: 1}]"
    run = "run", "descent.yaml", "--set", damage, "--set", "wire.unit=3", "--set", slow, "--wait-limit", "900"
    with emulator(*run) as port, ground_station(port, free_tcp_port(), tmp_path, "--unit", "3") as yamcs:
        eventually(lambda: (yamcs.latest("shot") or 0) > 20)
        shots = {raw_of(each["shot"]) for each in yamcs.archived(["shot"])}
        assert shots.isdisjoint({10, 11, 12, 13})
        yamcs.send("set_rate_hz", unit=3, rate_hz=10)
        eventually(lambda: yamcs.latest("acknowledge_verdict") == "accepted")
        assert yamcs.latest("acknowledge_command") == "set_rate_hz"
        yamcs.send("set_mode", unit=3, mode="self_test")
        eventually(lambda: yamcs.latest("acknowledge_command") == "set_mode")
        assert yamcs.latest("acknowledge_verdict") == "out_of_state"
        assert yamcs.latest("acknowledge_sequence") == 1
        eventually(lambda: yamcs.latest("housekeeping_commands_accepted") == 1)

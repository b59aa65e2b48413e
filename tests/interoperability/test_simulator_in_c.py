"""The simulator in C, as a job of Trick would do it: its flight is measured as `simulate` measures the same flight."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from free_ports import free_udp_port
from waiting import LIMIT_S

from lidar_emu import read_recording, simulate

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("cc") is None, reason="not installed: gcc"),
]
SOURCE = Path(__file__).resolve().parents[2] / "examples" / "live_truth.c"
DURATION_S = 40
FLIGHT = {
    "site": "flat",
    "level": "geometric",
    "trajectory": {
        "kind": "profile",
        "waypoints": [{"altitude_m": 1000, "speed_mps": 40}, {"altitude_m": 40, "speed_mps": 8}],
    },
}


def test_a_descent_is_measured_as_simulated(tmp_path: Path) -> None:
    program, port = tmp_path / "live_truth", free_udp_port()
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    subprocess.run(["cc", *strict, str(SOURCE), "-o", str(program)], check=True, timeout=LIMIT_S)
    settings = [f"trajectory.listen=udp:127.0.0.1:{port}", "site=flat", "level=geometric"]
    command = [sys.executable, "-m", "lidar_emu", "run", "live.yaml", "--pace", "lockstep", "--json"]
    command += ["--record", "flight.mcap", *(word for setting in settings for word in ("--set", setting))]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL) as lidar:
        try:
            flown = subprocess.run(
                [program, str(port)], capture_output=True, text=True, check=False, timeout=LIMIT_S
            )
            assert flown.returncode == 0, flown.stderr
            assert lidar.wait(LIMIT_S) == 0
        finally:
            lidar.kill()
    measured, expected = read_recording(str(tmp_path / "flight.mcap")).measurement(), simulate("live", FLIGHT)
    shots = len(measured.shot)
    assert shots == DURATION_S * 20
    assert flown.stdout == f"{DURATION_S * 100 + 1} truths, {shots} packets in the replies\n"
    np.testing.assert_allclose(measured.range_m, expected.range_m[:shots], rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        measured.closing_speed_mps, expected.closing_speed_mps[:shots], rtol=0, atol=1e-6
    )


def test_a_refused_truth_ends_it(tmp_path: Path) -> None:
    """The reply says that the attitude is none."""
    program = tmp_path / "live_truth"
    subprocess.run(["cc", "-std=c99", str(SOURCE), "-o", str(program)], check=True, timeout=LIMIT_S)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as lidar:
        lidar.bind(("127.0.0.1", 0))
        lidar.settimeout(LIMIT_S)
        with subprocess.Popen(
            [program, str(lidar.getsockname()[1])], stderr=subprocess.PIPE, text=True
        ) as flown:
            truth, sender = lidar.recvfrom(65536)
            assert len(truth) == 152
            lidar.sendto(b"LEAN" + bytes([1, 0, 3, 0]) + bytes(16), sender)
            assert flown.communicate(timeout=LIMIT_S)[1] == "truth 0 was refused: status 3\n"
        assert flown.returncode == 1

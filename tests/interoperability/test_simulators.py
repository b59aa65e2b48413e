"""Simulators that send truth: their flights are measured as `simulate` measures the same flights.

`live_truth.c` flies by itself. 42 is a program that writes and waits as its source does, Trick one that calls the jobs;
both fly in the inertial frame of a rotating body.
"""

from __future__ import annotations

import datetime
import shutil
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from free_ports import free_tcp_port, free_udp_port
from numpy.typing import NDArray
from printed_blocks import ROOT, blocks
from scipy.spatial.transform import Rotation
from waiting import LIMIT_S, eventually

from lidar_emu import Measurement, read_recording, simulate

pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("cc") is None, reason="not installed: gcc")]
EXAMPLES = ROOT / "examples"
RUN_IN_LOCKSTEP = ["run", "live.yaml", "--pace", "lockstep"]
DURATION_S, RATE_HZ = 40, 100
FLIGHT = {
    "site": "flat",
    "level": "geometric",
    "trajectory": {
        "kind": "profile",
        "waypoints": [{"altitude_m": 1000, "speed_mps": 40}, {"altitude_m": 40, "speed_mps": 8}],
    },
}
TRUTH = struct.Struct("<4sHHI4xq3d3d3d4d3d")
LAST = 2


class State(NamedTuple):
    """State of a vehicle; quaternion scalar first, rate about its own axes."""

    time_s: float
    position_m: NDArray[np.float64]
    velocity_mps: NDArray[np.float64]
    attitude: NDArray[np.float64]
    rate_radps: NDArray[np.float64]


class Site(NamedTuple):
    """A site on Mars that is neither on the equator nor on the meridian."""

    latitude_deg: float = 18.4
    longitude_deg: float = 77.5
    radius_m: float = 3.39e6
    meridian_deg: float = 123.0
    rotation_radps: float = 7.088e-5

    def to_inertial(self, state: State) -> State:
        """A state in the site frame, in the inertial frame."""
        east_deg = self.meridian_deg + self.longitude_deg + np.degrees(self.rotation_radps * state.time_s)
        inertial_from_site = (
            Rotation.from_euler("z", east_deg, degrees=True)
            * Rotation.from_euler("y", -self.latitude_deg, degrees=True)
            * Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # up, east, north from east, north, up
        )
        rotation_radps = np.array([0.0, 0.0, self.rotation_radps])
        position_m = inertial_from_site.apply(state.position_m + np.array([0.0, 0.0, self.radius_m]))
        attitude = inertial_from_site * Rotation.from_quat(np.roll(state.attitude, -1))
        return State(
            state.time_s,
            position_m,
            inertial_from_site.apply(state.velocity_mps) + np.cross(rotation_radps, position_m),
            np.roll(attitude.as_quat(), 1),
            state.rate_radps + attitude.inv().apply(rotation_radps),
        )


SITE = Site()
DOWN = np.array([0.0, 0.5**0.5, 0.5**0.5, 0.0])


def descent(time_s: float) -> State:
    """The descent of FLIGHT in the site frame."""
    position_m = np.array([0.0, 0.0, 1000 - 40 * time_s + 0.4 * time_s**2])
    return State(time_s, position_m, np.array([0.0, 0.0, -40 + 0.8 * time_s]), DOWN, np.zeros(3))


def hover(time_s: float) -> State:
    """At rest over the ground."""
    return State(time_s, np.array([100.0, -200.0, 50.0]), np.zeros(3), DOWN, np.zeros(3))


def roll(time_s: float) -> State:
    """A flight with rates in all axes at once, turning about a skew body axis."""
    axis = np.array([2.0, -1.0, 2.0]) / 3
    rotation = Rotation.from_quat([0.1, 0.7, -0.3, 0.6]) * Rotation.from_rotvec(0.4 * time_s * axis)
    velocity_mps = np.array([3.0, -7.0, -11.0])
    position_m = np.array([10.0, 20.0, 500.0]) + velocity_mps * time_s
    return State(time_s, position_m, velocity_mps, np.roll(rotation.as_quat(), 1), 0.4 * axis)


def build(folder: Path, *sources: Path) -> Path:
    program = folder / "simulator"
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    include = [f"-I{EXAMPLES}", f"-I{EXAMPLES / 'trick'}"]
    subprocess.run(["cc", *strict, *include, *sources, "-o", program, "-lm"], check=True, timeout=LIMIT_S)
    return program


def lines_of_42(state: State, brackets: bool) -> str:
    """A message as 42 writes it, of flights that begin ten seconds before a leap year ends."""
    start = datetime.datetime(2028, 12, 31, 23, 59, 50)
    now = start + datetime.timedelta(microseconds=round(state.time_s * 1e6))
    orbit_m, orbit_mps = np.round(state.position_m, -3), np.round(state.velocity_mps)
    values = {
        "SC[0].qn": np.zeros(4),
        "SC[0].PosR": state.position_m - orbit_m,
        "SC[0].VelR": state.velocity_mps - orbit_mps,
        "SC[0].B[0].wn": state.rate_radps,
        "SC[0].B[0].qn": np.roll(state.attitude, -1),
        "SC[0].B[1].qn": np.zeros(4),
        "Orb[0].PosN": orbit_m,
        "Orb[0].VelN": orbit_mps,
    }
    lines = [now.strftime("TIME %Y-%j-%H:%M:") + f"{now.second + now.microsecond / 1e6:012.9f}"]
    for name, vector in values.items():
        text = " ".join(f"{value:18.12e}" for value in vector)
        lines.append(f"{name} = [{text}]" if brackets else f"{name} = {text}")
    return "\n".join([*lines, "[ENDMSG]" if brackets else "[EOF]", ""])


def connected(port: int, program: subprocess.Popen[str]) -> socket.socket:
    """A connection to a program that is about to listen."""

    def connect() -> socket.socket | None:
        assert program.poll() is None
        with suppress(ConnectionRefusedError):
            return socket.create_connection(("127.0.0.1", port), LIMIT_S)
        return None

    connection: socket.socket = eventually(connect)
    return connection


class Fly42:
    """42 with its bridge."""

    def __init__(self, folder: Path, brackets: bool = True) -> None:
        self.program, self.brackets = build(folder, EXAMPLES / "bridge_42.c"), brackets

    def __call__(self, flight: Callable[[float], State], steps: int, lidar_port: int) -> None:
        port = free_tcp_port()
        arguments = [str(port), str(lidar_port), *map(str, SITE)]
        with subprocess.Popen([self.program, *arguments], stdout=subprocess.PIPE, text=True) as bridge:
            try:
                with connected(port, bridge) as link:
                    for step in range(steps + 1):
                        state = SITE.to_inertial(flight(step / RATE_HZ))
                        link.sendall(lines_of_42(state, self.brackets).encode())
                        assert link.recv(4, socket.MSG_WAITALL) == b"Ack\0"
                assert bridge.wait(LIMIT_S) == 0
            finally:
                bridge.kill()


class FlyTrick:
    """A simulation of Trick with the jobs."""

    def __init__(self, folder: Path) -> None:
        main = Path(__file__).with_name("simulators") / "trick.c"
        self.program = build(folder, EXAMPLES / "trick" / "lidar_truth_job.c", main)

    def __call__(self, flight: Callable[[float], State], steps: int, lidar_port: int) -> None:
        angles = np.radians([SITE.latitude_deg, SITE.longitude_deg, SITE.meridian_deg])
        site = [angles[0], angles[1], SITE.radius_m, angles[2], SITE.rotation_radps]
        lines = []
        for step in range(steps + 1):
            state = SITE.to_inertial(flight(step / RATE_HZ))
            lines.append(" ".join(repr(float(value)) for part in state for value in np.atleast_1d(part)))
        command = [self.program, str(lidar_port), *(repr(float(value)) for value in site)]
        subprocess.run(command, input="\n".join(lines), text=True, check=True, timeout=LIMIT_S)


SIMULATORS = {"42": Fly42, "trick": FlyTrick}


@pytest.fixture(params=SIMULATORS)
def simulator(request: pytest.FixtureRequest, tmp_path: Path) -> Fly42 | FlyTrick:
    made: Fly42 | FlyTrick = SIMULATORS[request.param](tmp_path)
    return made


@contextmanager
def lidar_in_lockstep(folder: Path) -> Iterator[int]:
    """A port at which an emulator awaits the truth of FLIGHT; it records flight.mcap, and must end well."""
    port = free_udp_port()
    settings = [f"trajectory.listen=udp:127.0.0.1:{port}", "site=flat", "level=geometric"]
    command = [sys.executable, "-m", "lidar_emu", *RUN_IN_LOCKSTEP, "--json"]
    command += ["--record", "flight.mcap", *(word for setting in settings for word in ("--set", setting))]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL) as lidar:
        try:
            yield port
            assert lidar.wait(LIMIT_S) == 0
        finally:
            lidar.kill()


def assert_measured_as_simulated(folder: Path) -> Measurement:
    measured, expected = read_recording(str(folder / "flight.mcap")).measurement(), simulate("live", FLIGHT)
    shots = len(measured.shot)
    assert shots == DURATION_S * 20
    for name in ("range_m", "closing_speed_mps"):
        values = getattr(measured, name), getattr(expected, name)[:shots]
        np.testing.assert_allclose(*values, rtol=0, atol=1e-6, err_msg=name)
    return measured


def test_a_simulator_in_c(tmp_path: Path) -> None:
    program = build(tmp_path, EXAMPLES / "live_truth.c")
    with lidar_in_lockstep(tmp_path) as port:
        flown = subprocess.run(
            [program, str(port)], capture_output=True, text=True, check=False, timeout=LIMIT_S
        )
        assert flown.returncode == 0, flown.stderr
    shots = len(assert_measured_as_simulated(tmp_path).shot)
    assert flown.stdout == f"{DURATION_S * RATE_HZ + 1} truths, {shots} packets in the replies\n"


def test_a_descent_over_a_rotating_body(simulator: Fly42 | FlyTrick, tmp_path: Path) -> None:
    with lidar_in_lockstep(tmp_path) as port:
        simulator(descent, DURATION_S * RATE_HZ, port)
    assert_measured_as_simulated(tmp_path)


@contextmanager
def receiver() -> Iterator[tuple[int, list[tuple[object, ...]]]]:
    """A lidar that accepts every truth: its port, and the truths it gets until the last one."""
    truths: list[tuple[object, ...]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as lidar:
        lidar.bind(("127.0.0.1", 0))
        lidar.settimeout(LIMIT_S)

        def receive() -> None:
            while not truths or not int(truths[-1][2]) & LAST:  # type: ignore[call-overload]
                data, sender = lidar.recvfrom(65536)
                truths.append(TRUTH.unpack(data))
                lidar.sendto(b"LEAN" + bytes([1, 0, 0, 0]) + data[8:12] + bytes(4) + data[16:24], sender)

        thread = threading.Thread(target=receive)
        thread.start()
        yield lidar.getsockname()[1], truths
        thread.join(LIMIT_S)


def assert_truths(truths: list[tuple[object, ...]], flight: Callable[[float], State], steps: int) -> None:
    """One truth per step, and the last one again with its flag."""
    assert [(truth[0], truth[1]) for truth in truths] == [(b"LETR", 1)] * (steps + 2)
    assert [truth[2] for truth in truths] == [0] * (steps + 1) + [LAST]
    assert [truth[3] for truth in truths] == list(range(steps + 2))
    for step in range(steps + 2):
        state = flight(min(step, steps) / RATE_HZ)
        assert truths[step][4] == round(state.time_s * 1e9)
        values = np.array(truths[step][5:], dtype=np.float64)
        np.testing.assert_allclose(values[:3], state.position_m, rtol=0, atol=1e-6)
        np.testing.assert_allclose(values[3:6], state.velocity_mps, rtol=0, atol=1e-8)
        np.testing.assert_allclose(
            values[9:13] * np.sign(values[9:13] @ state.attitude), state.attitude, atol=1e-11
        )
        np.testing.assert_allclose(values[13:], state.rate_radps, rtol=0, atol=1e-11)


@pytest.mark.parametrize("flight", [hover, roll])
def test_truth_is_over_the_ground(simulator: Fly42 | FlyTrick, flight: Callable[[float], State]) -> None:
    """A vehicle that hovers has no velocity and no rate there, though 228 m/s in the inertial frame."""
    with receiver() as (port, truths):
        simulator(flight, 1500, port)
    assert_truths(truths, flight, 1500)


def test_42_without_brackets(tmp_path: Path) -> None:
    with receiver() as (port, truths):
        Fly42(tmp_path, brackets=False)(hover, 5, port)
    assert_truths(truths, hover, 5)


def test_42_without_the_prefixes(tmp_path: Path) -> None:
    program, port = build(tmp_path, EXAMPLES / "bridge_42.c"), free_tcp_port()
    arguments = [str(port), str(free_udp_port()), *map(str, SITE)]
    with subprocess.Popen([program, *arguments], stderr=subprocess.PIPE, text=True) as bridge:
        try:
            with connected(port, bridge) as link:
                link.sendall(b"TIME 2030-001-00:00:00.000000000\nSC[0].PosR = [0 0 0]\n[ENDMSG]\n")
                assert "see the prefixes in Inp_IPC.txt" in bridge.communicate(timeout=LIMIT_S)[1]
            assert bridge.returncode == 1
        finally:
            bridge.kill()


def test_the_printed_commands_of_42(tmp_path: Path) -> None:
    """The page prints the run and the site of these tests, and its bridge can be built."""
    mark = "run by: tests/interoperability/test_simulators.py"
    (printed,) = (block for block in blocks(ROOT / "docs/simulators.md") if block.left_out == mark)
    compiler, run, bridge = (command.split() for command in printed.commands)
    program = tmp_path / compiler[compiler.index("-o") + 1]
    compiler[compiler.index("-o") + 1] = str(program)
    subprocess.run(compiler, cwd=ROOT, check=True, timeout=LIMIT_S)
    assert run == ["lidar-emu", *RUN_IN_LOCKSTEP]
    assert bridge[0] == f"./{program.name}"
    assert tuple(map(float, bridge[3:])) == SITE
    assert program.is_file()


def test_a_refused_truth_ends_it(tmp_path: Path) -> None:
    """The reply says that the attitude is none."""
    program = build(tmp_path, EXAMPLES / "live_truth.c")
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

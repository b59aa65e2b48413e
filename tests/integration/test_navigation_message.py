"""A flight computer that sends its navigation solution, on a pty, UDP and CAN: what the run counts and records."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from free_ports import free_udp_port
from programs import CommandingHost, FarEnd, Program, read_summary
from waiting import LIMIT_S

from lidar_emu.errors import InputError
from lidar_emu.recording.read import Recording, read_recording
from lidar_protocol import (
    Acknowledge,
    CanReceiver,
    Host,
    Message,
    SerialReceiver,
    default_interface,
)
from lidar_protocol.commands import Argument

Start = Callable[..., Program]
HOST = Host(default_interface())
FLIGHT = ["descent.yaml", "--set", "level=geometric", "--set", "site=flat", "--record", "r.mcap",
          "--summary", "s.json", "--set", "device.clock.offset_s=100"]  # fmt: skip
COUNT = 20


def solution(number: int) -> dict[str, Argument]:
    """A solution with other values for each number."""
    fields = default_interface().commands.messages_by_name["navigation"].arguments  # type: ignore[union-attr]
    values: dict[str, Argument] = dict.fromkeys(fields, None)
    values |= {name: (number + beam) % 7 for beam, name in enumerate(n for n in fields if "_trust_" in n)}
    return values | {
        "time_ns": number * 10**9,
        "mode": number % 6,
        "altitude_m": 1000.0 - number,
        "velocity_up_mps": -number / 8,
        "sigma_altitude_m": None if number % 2 else 0.5,
    }


def check(recording: Recording, numbers: list[int], between_ns: tuple[int, int]) -> None:
    """What was sent is what the recording has, with the times of arrival on both clocks."""
    found = recording.host_messages()
    sent = [solution(number) for number in numbers]
    assert len(found) == len(numbers)
    assert found.sequence.tolist() == numbers
    for name in ("time_ns", "mode", "altitude_m", "velocity_up_mps", "sigma_altitude_m"):
        expected = [np.nan if each[name] is None else each[name] for each in sent]
        assert np.array_equal(found.values[name], expected, equal_nan=True), name
    assert (found.values["time_ns"].dtype, found.values["altitude_m"].dtype) == (np.int64, np.float64)
    assert np.isnan(found.values["position_east_m"]).all()
    for name in ("range_trust", "speed_trust"):
        expected = [[each[f"{name}_{beam}"] for beam in range(8)] for each in sent]
        assert found.values[name].tolist() == expected
    assert between_ns[0] <= found.arrived_ns[0] <= found.arrived_ns[-1] <= between_ns[1]
    assert (np.diff(found.arrived_ns) >= 0).all()
    # Scenario time and the computer's clock run alike, up to what the arrival of a command has moved on.
    assert np.ptp(found.arrived_ns - found.time_ns) == 0
    assert (found.device_ns - found.time_ns == 100 * 10**9).all()


def finish(run: Program, folder: Path) -> tuple[dict[str, Any], Recording]:
    run.signal(signal.SIGINT)
    run.wait()
    return read_summary(folder / "s.json"), read_recording(folder / "r.mcap")


def test_on_a_pty(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    run = start("run", *FLIGHT, "--port", far_end.path, "--baud", "3000000")
    host = CommandingHost(far_end)
    host.wait_for_shots(2)
    begun_ns = time.monotonic_ns()
    for number in range(COUNT):
        far_end.send(HOST.encode_message("navigation", sequence=number, **solution(number)))
    assert host.command("no_op") == "accepted"
    damaged = bytearray(HOST.encode_message("navigation", sequence=COUNT, **solution(1)))
    damaged[30] ^= 0x40
    later = HOST.encode_message("navigation", sequence=COUNT + 5, **solution(COUNT + 5))
    far_end.send(bytes(damaged) + b"\0noise\0" + later[:40] + later)
    assert host.command("set_rate_hz", rate_hz=10.0) == "accepted"
    summary, recording = finish(run, tmp_path)
    check(recording, [*range(COUNT), COUNT + 5], (begun_ns, time.monotonic_ns()))
    counts = summary["host_messages"]
    assert counts["navigation"] == {"accepted": COUNT + 1, "rejected": {}, "lost": 5}
    assert counts["bad_crc"] + counts["bad_frames"] == 3
    assert summary["commands"]["accepted"] == len(host.all(Acknowledge)) == 2
    assert f"navigation {COUNT + 1} received, lost 5" in run.out + run.err
    with pytest.raises(InputError, match="must be a message of the recording's interface: navigation"):
        recording.host_messages("position")


def test_on_udp(start: Start, tmp_path: Path) -> None:
    port = free_udp_port()
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as line:
        line.bind(("127.0.0.1", port))
        line.settimeout(LIMIT_S)
        run = start("run", *FLIGHT, "--port", f"udp:127.0.0.1:{port}")
        _, device = line.recvfrom(4096)
        begun_ns = time.monotonic_ns()
        for number in range(COUNT):
            line.sendto(HOST.encode_message("navigation", sequence=number, **solution(number)), device)
        line.sendto(HOST.encode_command("no_op", sequence=1), device)
        receiver = SerialReceiver(default_interface())
        while not any(isinstance(each, Acknowledge) for each in receiver.receive(line.recv(4096))):
            pass
        summary, recording = finish(run, tmp_path)
    check(recording, [*range(COUNT)], (begun_ns, time.monotonic_ns()))
    assert summary["host_messages"]["navigation"]["accepted"] == COUNT


def test_on_can(start: Start, tmp_path: Path) -> None:
    group = f"239.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.255"  # no other test has it
    # python-can's socket hears other groups too: other runs on this machine have another unit.
    unit = 1 + os.getpid() % 15
    host, receiver = Host(default_interface(), unit), CanReceiver(default_interface())
    with can.Bus(interface="udp_multicast", channel=group) as bus:
        run = start("run", *FLIGHT, "-i", "udp_multicast", "-c", group, "--set", f"wire.unit={unit}")

        def hear(kind: type) -> None:
            """Read up to a message of this kind."""
            found: list[Any] = []
            while not any(isinstance(each, kind) and each.unit == unit for each in found):
                frame = bus.recv(LIMIT_S)
                assert frame is not None
                found = receiver.receive(frame.arbitration_id, bytes(frame.data), frame.is_fd)

        def send(frames: list[Any]) -> None:
            for frame in frames:
                bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))

        hear(Message)
        begun_ns = time.monotonic_ns()
        for number in range(COUNT):
            hear(Message)  # no more at once than the system holds
            send(host.encode_message_frames("navigation", sequence=number, **solution(number)))
        send(host.encode_message_frames("navigation", sequence=COUNT, **solution(1))[:5])
        send([host.encode_command_frame("no_op", sequence=1)])
        hear(Acknowledge)
        summary, recording = finish(run, tmp_path)
    check(recording, [*range(COUNT)], (begun_ns, time.monotonic_ns()))
    assert summary["host_messages"]["navigation"] == {"accepted": COUNT, "rejected": {}, "lost": 0}

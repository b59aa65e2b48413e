"""The final message, decoded with `struct` from the interface description, and the processes that send it."""

from __future__ import annotations

import os
import select
import signal
import struct
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from waiting import LIMIT_S

from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import device_constants
from lidar_emu.errors import RunError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.command_handler import DownlinkEncoder
from lidar_emu.runtime.housekeeping import FinalMessage, HousekeepingSender
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.summary import Tally
from lidar_emu.scenario.device import DeviceBehaviour
from lidar_emu.transports.frames import unpack_frames
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_protocol import cobs, default_interface

SECOND_NS = 1_000_000_000
MESSAGE = b"these are the final message"


def final_message_of(tally: Tally, prepare: Callable[[bytes], None], can: bool = False) -> FinalMessage:
    encoder = DownlinkEncoder(default_interface(), 3, can)
    constants = device_constants(DeviceBehaviour(), 10.0, 4, 1)
    housekeeping = HousekeepingSender(
        encoder, DeviceTimeline(constants, initial(constants)), tally, None, prepare, []
    )
    return FinalMessage(encoder, housekeeping, prepare)


def test_they_are_a_housekeeping_packet_with_mode_safe_and_the_laser_off() -> None:
    tally = Tally(Pace.WALL)
    for status in (DeliveryStatus.LATE, DeliveryStatus.LATE, DeliveryStatus.DROPPED_FULL):
        tally.add_report(DeliveryReport(0, 0, -1, status))
    prepared: list[bytes] = []
    reported = final_message_of(tally, prepared.append)
    reported.on_opened("port", datetime.now(UTC))
    for tenth in range(26):
        reported.on_report(
            OutgoingPacket(tenth, tenth * SECOND_NS // 10, b""),
            DeliveryReport(tenth, tenth * SECOND_NS // 10, 0, DeliveryStatus.SENT),
        )
    assert len(prepared) == 1 + 2, "once a second"
    *_, frame, rest = prepared[-1].split(b"\0")
    assert rest == b""
    packet = cobs.decode(frame)
    (first,) = struct.unpack_from(">H", packet)
    assert first & 0x7FF == 0x2B0 + 3
    # Seconds and fraction of the time code, versions, mode, flags, temperature, power, uptime, lost shots.
    body = struct.unpack_from(">IBHBBBBBBhHIII", packet, 6)
    assert body[0] - struct.unpack_from(">I", cobs.decode(prepared[0].split(b"\0")[-2]), 6)[0] == 2
    mode, flags, temperature, power, uptime_s, dropped, late = body[7:]
    assert (mode, flags) == (6, 0b101), "safe; interlock closed, laser off, clock locked"
    assert (2000 <= temperature < 2050, power) == (True, 0), "hundredths of a degree; mW"
    assert (uptime_s, dropped, late) == (2, 1, 2)


def test_none_is_prepared_for_reports_that_arrive_after_the_port_is_closed() -> None:
    prepared: list[bytes] = []
    message = final_message_of(Tally(Pace.WALL), prepared.append)
    message.end()
    due_ns = 2 * SECOND_NS
    message.on_report(OutgoingPacket(0, due_ns, b""), DeliveryReport(0, due_ns, 0, DeliveryStatus.SENT))
    assert prepared == []


def test_on_can_they_are_frames() -> None:
    frames = unpack_frames(final_message_of(Tally(Pace.WALL), lambda _: None, can=True).payload())
    assert {frame.can_id for frame in frames} == {0x100 + 3 * 0x40 + k for k in range(0x39, 0x3E)}
    assert next(frame.data[0] for frame in frames if frame.can_id & 0x3F == 0x39) == 6


@pytest.fixture
def line() -> Any:
    """A serial line: the far end's descriptor, and the device's name."""
    master, slave = os.openpty()
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def begun(path: str, runner: PortRunner) -> None:
    """One packet is sent, one is due in an hour."""
    runner.start(PortSpec(Kind.SERIAL, path))
    runner.begin(Clock().now_ns(), 60 * SECOND_NS, Pace.WALL)
    runner.set_final_message(b"first draft")
    runner.set_final_message(MESSAGE)
    runner.push(OutgoingPacket(0, 0, b"now"))
    runner.push(OutgoingPacket(1, 3600 * SECOND_NS, b"in an hour"))
    while not runner.reports():
        runner.wait(Clock().now_ns() + SECOND_NS)


@pytest.mark.parametrize(
    ("error", "reported"), [(MemoryError, MESSAGE), (KeyboardInterrupt, b""), (None, b"")]
)
def test_a_run_that_fails_by_itself_states_them_too(
    error: type[BaseException] | None, reported: bytes, line: Any
) -> None:
    master, path = line

    def run() -> None:
        with PortRunner(slots=8) as runner:
            begun(path, runner)
            if error is not None:
                raise error

    if error is None:
        run()
    else:
        with pytest.raises(error):
            run()
    data = b""
    # What was written before the process ended; afterwards nobody writes any more.
    while len(data) < len(b"now" + reported) and select.select([master], [], [], LIMIT_S)[0]:
        data += os.read(master, 100)
    while select.select([master], [], [], 0)[0]:
        data += os.read(master, 100)
    assert data == b"now" + reported


def open_descriptors() -> list[str]:
    links = sorted(Path("/proc/self/fd").iterdir(), key=lambda link: int(link.name))
    return [os.readlink(link) for link in links if link.exists()]  # noqa: PTH115


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_whatever_becomes_of_the_process_no_descriptor_and_no_memory_is_left(
    number: signal.Signals, line: Any
) -> None:
    _, path = line
    before = open_descriptors()
    with PortRunner(slots=8) as runner:
        begun(path, runner)
        assert any("memfd:lidar-emu" in name for name in open_descriptors())
        assert runner.pid is not None
        os.kill(runner.pid, number)
        if number is signal.SIGKILL:
            with pytest.raises(RunError, match="signal 9"):
                runner.finish()
    assert open_descriptors() == before
    assert not Path(f"/proc/{runner.pid}").exists()

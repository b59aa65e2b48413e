"""The port process end to end: real processes, real descriptors."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.transports.spec import Kind, PortSpec

SECOND_NS = 1_000_000_000
LOOPBACK, PTY = PortSpec(), PortSpec(Kind.PTY)


def packets(count: int, period_ns: int = 0) -> list[OutgoingPacket]:
    """Packets of various lengths, with every byte value."""
    return [
        OutgoingPacket(k, k * period_ns, k.to_bytes(3, "big") + bytes(range(k % 256))) for k in range(count)
    ]


def joined(sent: list[OutgoingPacket]) -> bytes:
    return b"".join(packet.payload for packet in sent)


def fly(
    runner: PortRunner, sent: list[OutgoingPacket], pace: Pace, late_after_ns: int = 0
) -> list[DeliveryReport]:
    """Push everything and wait for the end."""
    runner.begin(Clock().now_ns(), late_after_ns, pace)
    for packet in sent:
        while not runner.push(packet):
            runner.wait(Clock().now_ns() + 5_000_000)
    runner.finish()
    return runner.reports()


@pytest.fixture
def runner() -> Iterator[PortRunner]:
    with PortRunner(slots=64) as runner:
        yield runner


def test_the_loopback_delivers_every_byte_in_order_at_full_speed(runner: PortRunner) -> None:
    sent = packets(3000, SECOND_NS)
    assert runner.start(LOOPBACK) == "in-memory loopback"
    reports = fly(runner, sent, Pace.MAX)
    assert runner.far_end() == joined(sent)
    assert [(report.shot, report.due_ns) for report in reports] == [(p.shot, p.due_ns) for p in sent]
    assert {report.status for report in reports} == {DeliveryStatus.SENT}
    assert runner.status.counts["sent_bytes"] == len(joined(sent))
    assert runner.status.events == []


def test_after_an_alert_packets_go_their_usual_way(runner: PortRunner) -> None:
    """Whether they come at once, in vain is waited for, or are not due yet."""
    runner.start(LOOPBACK)
    runner.request_realtime()
    runner.begin(Clock().now_ns(), 60 * SECOND_NS, Pace.WALL)
    sent = packets(30, SECOND_NS // 200)
    for packet in sent:
        runner.wake_up()
        assert runner.push(packet)
    runner.wake_up()
    runner.finish()
    reports = runner.reports()
    assert [(report.shot, report.status) for report in reports] == [
        (k, DeliveryStatus.SENT) for k in range(30)
    ]
    assert all(report.sent_ns >= report.due_ns for report in reports)
    privileges = {*runner.status.granted, *runner.status.missing}
    assert privileges == {"fifo", "isolated_core", "locked_memory", "timer_slack"}


def test_packets_pushed_before_the_beginning_wait_for_it(runner: PortRunner) -> None:
    runner.start(LOOPBACK)
    sent = packets(64)
    assert all(runner.push(packet) for packet in sent)
    assert not runner.push(sent[0])
    assert runner.reports() == []
    reports = fly(runner, [], Pace.MAX)
    assert len(reports) == 64
    assert runner.far_end() == joined(sent)


def test_what_counts_as_sent_is_read_even_where_the_run_is_cut_off(
    runner: PortRunner, eventually: Any
) -> None:
    reader = os.open(runner.start(PTY), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    runner.begin(Clock().now_ns(), 0, Pace.MAX)
    sent = packets(20)
    assert all(runner.push(packet) for packet in sent)
    reports: list[DeliveryReport] = []
    eventually(lambda: reports.extend(runner.reports()) or len(reports) == 20)
    closing = threading.Thread(target=runner.close)
    closing.start()
    closing.join(0.05)  # by then the port would be closed if nobody was waited for
    data = b""
    while len(data) < len(joined(sent)):
        select.select([reader], [], [])
        read = os.read(reader, 100)
        assert read, "the port was closed too early"
        data += read
    closing.join()
    os.close(reader)
    assert data == joined(sent)
    assert runner.status.counts["sent_bytes"] == len(data)


@pytest.mark.parametrize("taken", [0, 100])
def test_what_the_host_never_reads_is_counted(runner: PortRunner, taken: int, eventually: Any) -> None:
    reader = os.open(runner.start(PTY), os.O_RDWR | os.O_NOCTTY)
    runner.begin(Clock().now_ns(), 0, Pace.MAX)
    assert all(runner.push(packet) for packet in packets(10))
    reports: list[DeliveryReport] = []
    eventually(lambda: reports.extend(runner.reports()) or len(reports) == 10)
    read = os.read(reader, taken)
    runner.close()
    os.close(reader)
    assert runner.status.counts["unread_bytes"] == (runner.status.counts["sent_bytes"] or 0) - len(read)


@pytest.mark.parametrize(
    "spec",
    [
        PortSpec(Kind.SERIAL, "/dev/nothing-of-the-kind"),
        PortSpec(Kind.CAN, interface="nonsense", channel="x"),
    ],
)
def test_a_port_that_cannot_be_opened_is_the_users_error(runner: PortRunner, spec: PortSpec) -> None:
    with pytest.raises(InputError) as refused:
        runner.start(spec)
    assert refused.value.where in ("--port", "--interface")
    runner.close()


def test_a_packet_longer_than_agreed_is_an_error() -> None:
    with PortRunner(slots=4, packet_bytes=100) as runner:
        runner.start(LOOPBACK)
        assert runner.push(OutgoingPacket(0, 0, bytes(100)))
        with pytest.raises(ValueError, match="do not fit"):
            runner.push(OutgoingPacket(1, 0, bytes(200)))


def test_a_killed_port_process_is_a_failed_run(runner: PortRunner) -> None:
    runner.start(LOOPBACK)
    runner.begin(Clock().now_ns(), 0, Pace.MAX)
    assert runner.pid is not None
    os.kill(runner.pid, signal.SIGKILL)
    with pytest.raises(RunError, match="signal 9"):
        runner.finish()
    runner.close()
    assert runner.status.counts["sent_bytes"] is None


def test_the_link_of_a_killed_port_process_leads_nowhere_and_is_removed(
    runner: PortRunner, tmp_path: Path
) -> None:
    link = tmp_path / "lidar"
    runner.start(PortSpec(Kind.PTY, str(link)))
    assert link.exists()
    runner.begin(Clock().now_ns(), 0, Pace.MAX)
    os.kill(runner.pid or 0, signal.SIGKILL)
    with pytest.raises(RunError, match="signal 9"):
        runner.finish()
    runner.close()
    assert not link.is_symlink()


def test_an_error_in_the_port_process_is_reported_in_its_own_words(runner: PortRunner) -> None:
    master, slave = os.openpty()
    runner.start(PortSpec(Kind.CAN, interface="slcan", channel=os.ttyname(slave)))
    with pytest.raises(RunError, match="records end inside"):
        fly(runner, [OutgoingPacket(0, 0, b"no frame records")], Pace.MAX)
    os.close(slave)
    os.close(master)


def test_order_matters(runner: PortRunner) -> None:
    with pytest.raises(RunError, match="not open"):
        runner.push(OutgoingPacket(0, 0, b""))
    runner.start(LOOPBACK)
    with pytest.raises(RunError, match="not begun"):
        runner.finish()
    runner.close()
    runner.close()
    with pytest.raises(RunError, match="not open"):
        runner.push(OutgoingPacket(0, 0, b""))
    assert (runner.reports(), runner.far_end()) == ([], b"")


def test_closing_in_mid_run_keeps_what_is_known(runner: PortRunner, eventually: Any) -> None:
    runner.start(LOOPBACK)
    runner.begin(Clock().now_ns(), SECOND_NS * 3600, Pace.WALL)
    runner.push(OutgoingPacket(0, 0, b"now"))
    runner.push(OutgoingPacket(1, 3600 * SECOND_NS, b"in an hour"))
    got = bytearray()
    eventually(lambda: got.extend(runner.far_end()) or got == b"now")
    runner.close()
    assert [report.shot for report in runner.reports()] == [0]
    assert runner.status.counts["sent_bytes"] == 3


def test_the_port_process_imports_little() -> None:
    code = "import sys, lidar_emu.runtime.port.process; print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    heavy = {"numpy", "scipy", "numba", "pydantic", "click", "can", "serial", "ctypes.wintypes", "asyncio"}
    assert heavy.isdisjoint(modules.split())

"""Faults of the port in its own process: real processes, real descriptors, a real clock."""

from __future__ import annotations

from typing import Any

import pytest

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.transports.spec import PortSpec

MS = 1_000_000
PACKETS = [OutgoingPacket(k, 10 * k * MS, bytes([k]) * 20) for k in range(60)]


def flown(*orders: dict[str, Any], later: bool = False) -> tuple[list[DeliveryReport], bytes, PortRunner]:
    """Sixty packets in 0.6 s through the loopback; what became of them, and what came out."""
    with PortRunner(slots=64) as runner:
        runner.start(PortSpec(), [] if later else list(orders))
        runner.begin(Clock().now_ns() + 20 * MS, 1000 * MS, Pace.WALL)
        for order in orders if later else ():
            runner.inject_fault(order)
        for packet in PACKETS:
            assert runner.push(packet)
        runner.finish()
        return runner.reports(), runner.far_end(), runner


def order(kind: str, **more: Any) -> dict[str, Any]:
    return {"number": 0, "kind": kind, "from_ns": 205 * MS, "to_ns": 405 * MS, **more}


def joined(reports: list[DeliveryReport]) -> bytes:
    return b"".join(
        PACKETS[report.shot].payload for report in reports if report.status is DeliveryStatus.SENT
    )


@pytest.mark.parametrize("later", [False, True])
def test_disconnect(later: bool) -> None:
    reports, out, runner = flown(order("disconnect"), later=later)
    assert len(reports) == len(PACKETS)
    # By when the port turned to them, not by when they were due: a starved process is late.
    assert {each.status for each in reports if each.woke_ns < 205 * MS} == {DeliveryStatus.SENT}
    during = {each.status for each in reports if 205 * MS <= each.woke_ns < 405 * MS}
    assert during == {DeliveryStatus.DROPPED_BROKEN}
    assert out == joined(reports)
    assert (
        next(event.text for event in runner.status.events) == "link broken: disconnected by an injected fault"
    )

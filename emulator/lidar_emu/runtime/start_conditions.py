"""What a run waits for before its first shot: a host that opens the port, or a command that makes the device acquire.

Live truth, which starts a run too, is waited for by its feed, as the first truth is also the first to be used.
"""

from __future__ import annotations

from dataclasses import replace

from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import DeviceConstants, Mode
from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.feed.base import POLL_NS, PacketQueue
from lidar_emu.runtime.housekeeping import HousekeepingSender
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.run_status import RunStatus
from lidar_emu.session import Session

_SETTLED_NS = 100_000_000
"""A program that only sets the terminal (`stty`) closes the port sooner than that."""
_LEAD_NS = 100_000_000
"""From the command to scenario time 0."""


def wait_for_host(status: RunStatus, port: PortRunner, changes: ChangeQueue | None = None) -> bool:
    """Wait until the other end has had the port open for a tenth of a second.

    Args:
        status: limits the wait.
        port: the open port.
        changes: meanwhile receives commands and injected faults, which affect the flight from its first shot on.

    Returns:
        Whether the host is there; False: the wait was ended.

    Raises:
        PortDiedError: the port process died.
    """
    since_ns: int | None = None
    while status.may_wait():
        if changes is not None:
            changes.receive(0)
        now_ns = status.clock.now_ns()
        if not port.status.connected:
            since_ns = None
        elif since_ns is None:
            since_ns = now_ns
        elif now_ns - since_ns >= _SETTLED_NS:
            return True
        port.wait(now_ns + POLL_NS)
    return False


def waiting_device(constants: DeviceConstants) -> DeviceTimeline:
    """The device before the flight: times count from power-up, and the scenario's timed events are left out."""
    start = Mode.STANDBY if constants.start is Mode.TRACK else constants.start
    before = replace(constants, start=start, events=())
    return DeviceTimeline(before, initial(before))


def wait_for_command(
    status: RunStatus,
    session: Session,
    packets: PacketQueue,
    changes: ChangeQueue,
    device: DeviceTimeline,
    housekeeping: HousekeepingSender | None,
) -> int | None:
    """Wait until a command makes the device acquire; until then it boots, acknowledges and sends housekeeping.

    Args:
        device: see `waiting_device`.
        housekeeping: sends housekeeping; None: the interface has none.

    Returns:
        The instant of the monotonic clock at scenario time 0; None: the wait was ended.
    """
    clock = status.clock
    powered_ns = clock.now_ns()
    while status.may_wait():
        now_ns = clock.now_ns() - powered_ns
        changes.receive(now_ns, powered_ns)
        while changes.first is not None:
            changes.apply_first(session, None)
        if device.at(now_ns).measures:
            break
        if housekeeping is not None:
            housekeeping.send_due(now_ns)
        packets.port.wait(clock.now_ns() + POLL_NS)
        packets.collect_reports()
    else:
        return None
    start_ns = clock.now_ns() + _LEAD_NS
    session.use_device(device.start_flight(session.constants, start_ns - powered_ns))
    if housekeeping is not None:
        housekeeping.start_flight()
    for observer in status.observers:
        observer.on_flight_started(start_ns - powered_ns)
    return start_ns

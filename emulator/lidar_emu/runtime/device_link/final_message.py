"""What a host still hears where one of the emulator's processes dies: that the device is safe, its laser off."""

from __future__ import annotations

from collections.abc import Callable

from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.device_link.encoder import DownlinkEncoder, housekeeping_layouts
from lidar_emu.runtime.device_link.housekeeping import HousekeepingSender
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.runtime.port.packets import Outgoing, Report
from lidar_emu.runtime.port.parent_death import told_of
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_protocol import Interface

_EVERY_NS = 1_000_000_000
_AT_ONCE_NS = 10_000_000_000
_ENDED_WITH_ITS_PROCESS = (Kind.PTY, Kind.LOOPBACK)


def why_no_final_message(interface: Interface, can: bool) -> str | None:
    """Why nothing could be said on such a link; None if it can."""
    fields = (placed.field for layout in housekeeping_layouts(interface, can) for placed in layout.placed)
    known = (interface.enumerations.get(field.enumeration or "") for field in fields if field.name == "mode")
    if any(words and "safe" in words for words in known):
        return None
    lacks = f"interface {interface.name} has no housekeeping with mode safe on this link"
    return f"{lacks}: nothing is sent where a process dies"


class FinalMessage(Observer):
    """Prepared, and prepared anew every second of a run, since whoever needs them can ask nobody any more.

    Args:
        voice: by which they are said.
        housekeeper: knows how the device is; None where the interface has no housekeeping.
        prepare: gives them to the port's process.
    """

    def __init__(
        self, voice: DownlinkEncoder, housekeeper: HousekeepingSender | None, prepare: Callable[[bytes], None]
    ) -> None:
        self._why_not = why_no_final_message(voice.interface, voice.can)
        self._housekeeper = None if self._why_not else housekeeper
        self._prepare = prepare
        self._time_ns = self._prepared_ns = 0
        self.told: str | None = None
        """What became of them; None where they were not needed."""

    def words(self) -> bytes:
        """Housekeeping of a device that is safe as of the last report, as the port's process takes it; empty where it
        cannot be said."""
        if self._housekeeper is None:
            return b""
        return self._housekeeper.composed(self._time_ns, mode="safe", laser_on=False, laser_power_w=0.0)

    def begin(self) -> None:
        """The port's process has heard when the run begins."""
        self._prepare(self.words())

    def on_report(self, packet: Outgoing, report: Report) -> None:  # noqa: ARG002
        """Every second they are another's."""
        self._time_ns = report.due_ns
        if report.due_ns - self._prepared_ns >= _EVERY_NS:
            self._prepared_ns = report.due_ns
            self._prepare(self.words())

    def say(self, spec: PortSpec, clock: Clock) -> None:
        """The port's process died: say them over the port, opened anew."""
        words = self.words()
        if not words:
            self.told = "none"
        elif spec.kind in _ENDED_WITH_ITS_PROCESS:
            self.told = "not sent: the line ended with the port's process"
        else:
            self.told = _sent_alone(spec, words, clock)


def _sent_alone(spec: PortSpec, words: bytes, clock: Clock) -> str:
    try:
        with PortRunner(1, len(words)) as port:
            port.start(spec)
            port.begin(clock.now_ns(), _AT_ONCE_NS, Pace.WALL)
            port.push(Outgoing(0, 0, words))
            port.finish()
            (report,) = port.reports()
    except (InputError, RunError) as error:
        return f"not sent: {error}"
    return told_of(report.status)

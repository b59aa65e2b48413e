"""What a host still hears where one of the emulator's processes dies: that the device is safe, its laser off."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from lidar_emu import __version__
from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.orphan import told_of
from lidar_emu.runtime.outbox import payload_of
from lidar_emu.runtime.pacing import Pace
from lidar_emu.runtime.packets import Outgoing, Report
from lidar_emu.runtime.run import PortRunner
from lidar_emu.runtime.summary import Tally
from lidar_emu.scenario.schema import Scenario
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_protocol import Device, EncodeError, Interface
from lidar_protocol.commands import Argument

_EVERY_NS = 1_000_000_000
_AT_ONCE_NS = 10_000_000_000
_SAFE: Mapping[str, Argument] = {"mode": "safe", "laser_on": False, "laser_power_w": 0.0}
_ENDED_WITH_ITS_PROCESS = (Kind.PTY, Kind.LOOPBACK)


def last_words(
    interface: Interface, unit: int, can: bool, values: Mapping[str, Argument], number: int = 0
) -> bytes:
    """Housekeeping of a device that is safe, as the port's process takes it; empty where the interface has none, or
    no such mode.

    Args:
        interface: by which it is said.
        unit: who says it.
        can: whether as CAN frames.
        values: of the other fields.
        number: how many housekeeping packets went before.
    """
    device, said = Device(interface, unit), {**values, **_SAFE}
    try:
        return payload_of(device.housekeeping_frames(said) if can else device.housekeeping(number, said))
    except EncodeError:
        return b""


def last_words_of(scenario: Scenario, interface: Interface, port: PortSpec, tally: Tally) -> LastWords | None:
    """Those of a run; None where the scenario wants none."""
    if scenario.timing.when_process_dies == "end":
        return None
    return LastWords(interface, scenario.wire.unit, port.kind is Kind.CAN, tally)


class LastWords(Observer):
    """Prepared, and prepared anew every second of a run, since whoever needs them can ask nobody any more.

    Args:
        interface: by which they are said, as of `last_words`.
        unit: who says them.
        can: whether as CAN frames.
        tally: of the run.
    """

    def __init__(self, interface: Interface, unit: int, can: bool, tally: Tally) -> None:
        self._interface, self._unit, self._can = interface, unit, can
        self._tally = tally
        self._time_ns = self._prepared_ns = 0
        self._prepare: Callable[[bytes], None] | None = None
        self.warning = None if self.words() else f"{self._unsayable}: nothing is sent where a process dies"
        """For the user, before the run."""
        self.told: str | None = None
        """What became of them; None where they were not needed."""

    def words(self) -> bytes:
        """As of the last report."""
        major, minor, patch = (int(part) for part in __version__.split(".")[:3])
        time_s = self._time_ns * 1e-9
        values: dict[str, Argument] = {
            "time_ns": self._time_ns, "time_s": time_s, "uptime_s": int(time_s),
            "software_major": major, "software_minor": minor, "software_patch": patch,
            "interlock_closed": True, "clock_locked": True, "temperature_c": None, "truth_age_s": None,
            "shots_dropped": self._tally.dropped, "shots_late": self._tally.late,
            "commands_accepted": 0, "commands_rejected": 0, "bad_bytes": 0,
        }  # fmt: skip
        return last_words(self._interface, self._unit, self._can, values)

    def begin(self, prepare: Callable[[bytes], None]) -> None:
        """The run begins: `prepare` gives them to the port's process."""
        self._prepare = prepare
        prepare(self.words())

    def report(self, packet: Outgoing, report: Report) -> None:  # noqa: ARG002
        """Every second they are another's."""
        self._time_ns = report.due_ns
        if report.due_ns - self._prepared_ns >= _EVERY_NS and self._prepare is not None:
            self._prepared_ns = report.due_ns
            self._prepare(self.words())

    def say(self, spec: PortSpec, clock: Clock) -> None:
        """The port's process died: say them over the port, opened anew."""
        words = self.words()
        if not words:
            self.told = f"none: {self._unsayable}"
        elif spec.kind in _ENDED_WITH_ITS_PROCESS:
            self.told = "not sent: the line ended with the port's process"
        else:
            self.told = _sent_alone(spec, words, clock)

    @property
    def _unsayable(self) -> str:
        return f"interface {self._interface.name} has no housekeeping with mode safe on this link"


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
    return told_of(report.fate)

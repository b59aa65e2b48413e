"""What the live display shows of a run and of a listener: the last messages, the last minute, the next events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lidar_emu.cli.dashboard import Dashboard
from lidar_emu.cli.messages import counter_line, reason
from lidar_emu.runtime.observer import EventSource, Observer
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace
from lidar_emu.runtime.summary import Tally
from lidar_emu.scenario.scanner import AltitudeSwitch, TimeSwitch
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Block
from lidar_emu.transports.frames import unpack_frames
from lidar_emu.transports.messages import Decoder
from lidar_emu.wire import rows
from lidar_protocol import Acknowledge, Interface, Message, Received

if TYPE_CHECKING:
    from lidar_emu.trajectory.profile import Trajectory

_BEAMS_SENT = 256
_SECONDS = 60
_FAULT_STAYS_NS = 1_000_000_000

Line = tuple[str, str]


class LatestMessages:
    """The last messages of each unit, as rows and lines."""

    def __init__(self, interface: Interface) -> None:
        self._interface = interface
        self._shots: dict[int, Message] = {}
        self._states: dict[int, dict[str, Any]] = {}
        self._acknowledgement = ""
        self.scale_m = 0.0
        """Largest range so far, the full length of bars."""

    def store(self, messages: Iterable[Received]) -> None:
        """Store the newest messages."""
        for message in messages:
            if isinstance(message, Acknowledge):
                self._acknowledgement = f"{message.command or 'unknown'}: {message.verdict.replace('_', ' ')}"
                continue
            if isinstance(message, Message):
                self._shots[message.unit] = message
                self.scale_m = max(self.scale_m, *(row.get("range_m") or 0.0 for row in rows(message)), 0.0)
            fields = message.header if isinstance(message, Message) else message.values
            self._states.setdefault(message.unit, {}).update(fields)

    def beams(self) -> list[tuple[Any, ...]]:
        """Rows of beams: name, range, closing speed, SNR, and the reason if invalid."""
        several = len(self._shots) > 1
        return [
            (
                f"{unit}.{beam}" if several else str(beam),
                *(row.get(name) for name in ("range_m", "closing_speed_mps", "snr_db")),
                None
                if row.get("range_valid", row.get("range_m") is not None)
                else reason(row, self._interface),
            )
            for unit, message in sorted(self._shots.items())
            for beam, row in enumerate(rows(message))
        ][:_BEAMS_SENT]

    def lines(self) -> list[Line]:
        """Mode and flags of each unit; the last acknowledgement."""
        lines = [("device", self._state(unit, state)) for unit, state in sorted(self._states.items())]
        return [*lines, *([("command", self._acknowledgement)] if self._acknowledgement else [])]

    def _state(self, unit: int, state: dict[str, Any]) -> str:
        parts = [f"unit {unit}"]
        if (mode := state.get("mode")) is not None:
            parts.append(self._interface.word("mode", int(mode)) or str(mode))
        flags = (("laser_on", "laser"), ("clock_locked", "clock"), ("interlock_closed", "interlock"))
        words = {"laser": ("off", "on"), "clock": ("free", "locked"), "interlock": ("open", "closed")}
        parts += [f"{word} {words[word][bool(state[name])]}" for name, word in flags if name in state]
        if (temperature_c := state.get("temperature_c")) is not None:
            parts.append(f"{temperature_c:.1f} °C")
        return ", ".join(parts).replace("_", " ")

    def last_shot(self) -> Message | None:
        """The latest shot of any unit."""
        return max(self._shots.values(), key=lambda message: message.time_ns or 0, default=None)


def _time_line(latest: LatestMessages, until: str = "") -> list[Line]:
    last = latest.last_shot()
    if last is None:
        return []
    time = "-" if last.time_ns is None else f"{last.time_ns * 1e-9:.3f} s{until}"
    number = last.sequence if last.shot is None else last.shot
    return [("time", time + ("" if number is None else f", shot {number}"))]


@dataclass
class _Second:
    fired: int = 0
    valid: int = 0
    late_ns: int = 0
    sent_bytes: int = 0


class LastMinute:
    """Valid beams, lateness and bytes of each second of the last minute, by the due times of the packets."""

    def __init__(self) -> None:
        self._seconds: dict[int, _Second] = {}

    def add_block(self, block: Block) -> None:
        """Count the beams of a block that fired, and the valid ones."""
        measured = block.measurement
        fired, valid = measured.fired.sum(axis=1), (measured.fired & measured.range_valid).sum(axis=1)
        for due_ns, beams, good in zip(block.due_ns, fired.tolist(), valid.tolist(), strict=True):
            second = self._second(int(due_ns))
            second.fired += beams
            second.valid += good

    def add_packet(self, due_ns: int, late_ns: int, size_bytes: int) -> None:
        """Count a packet sent."""
        second = self._second(due_ns)
        second.late_ns = max(second.late_ns, late_ns)
        second.sent_bytes += size_bytes

    def _second(self, due_ns: int) -> _Second:
        number = due_ns // 1_000_000_000
        if number not in self._seconds:
            self._seconds[number] = _Second()
            for old in [each for each in self._seconds if each <= max(self._seconds) - _SECONDS]:
                del self._seconds[old]
        return self._seconds.get(number) or _Second()

    def load_bps(self) -> float:
        """Bytes per second in the last complete second; 0 before there is one."""
        complete = sorted(self._seconds)[:-1]
        return float(self._seconds[complete[-1]].sent_bytes) if complete else 0.0

    def curves(self, keeps_time: bool) -> list[tuple[str, list[float], str]]:
        """Label, value of each second from 0 to 1, and text of each curve.

        Args:
            keeps_time: whether packets have deadlines, so that there is a lateness.
        """
        seconds = [self._seconds[number] for number in sorted(self._seconds)]
        fired, valid = (sum(getattr(each, name) for each in seconds) for name in ("fired", "valid"))
        worst_ns, most = (max((getattr(each, name) for each in seconds), default=0)
                          for name in ("late_ns", "sent_bytes"))  # fmt: skip
        curves = []
        if fired:
            shares = [each.valid / each.fired if each.fired else 0.0 for each in seconds]
            curves.append(("validity", shares, f"{100 * valid / fired:.1f} % of the last minute"))
        if keeps_time and worst_ns:
            late = [each.late_ns / worst_ns for each in seconds]
            curves.append(("lateness", late, f"at most {worst_ns / 1e3:.0f} us in the last minute"))
        if most:
            load = [each.sent_bytes / most for each in seconds]
            curves.append(("load", load, f"at most {most / 1e3:.1f} kB/s in the last minute"))
        return curves


class ListenDisplay:
    """Live display of received messages."""

    def __init__(self, dashboard: Dashboard, decoder: Decoder) -> None:
        self._dashboard, self._decoder = dashboard, decoder
        self._latest = LatestMessages(decoder.interface)

    def store(self, messages: Iterable[Received]) -> None:
        """Store messages, and update the display when it is due."""
        self._latest.store(messages)
        if self._dashboard.is_due:
            lines = [
                *_time_line(self._latest),
                ("received", counter_line(self._decoder.counters())),
                *self._latest.lines(),
            ]
            self._dashboard.show(
                {"beams": self._latest.beams(), "scale_m": self._latest.scale_m, "lines": lines}
            )


class RunDisplay(Observer):
    """Live display of a run: the last packet sent, counts, lateness, link and faults.

    Args:
        is_can: whether packets are frame records.
        duration_s: planned duration of the run; None if unknown.
        events: what the scenario holds for the run, see `scheduled_events`.
    """

    def __init__(
        self,
        dashboard: Dashboard,
        interface: Interface,
        is_can: bool,
        tally: Tally,
        duration_s: float | None,
        events: list[ScheduledEvent],
    ) -> None:
        self._events = events
        self._dashboard, self._decoder, self._is_can = dashboard, Decoder(interface), is_can
        self._latest = LatestMessages(interface)
        self._tally = tally
        self._until = "" if duration_s is None else f" of {duration_s:g} s"
        self._recent_lateness_ns = self._largest_lateness_ns = self._sent_bytes = 0
        self._faults_due_ns: dict[str, int] = {}
        self._notice = ""
        self._altitude_m = math.nan
        self._minute = LastMinute()

    def on_waiting(self, port: str, what: str) -> None:  # noqa: ARG002
        self._notice = f"waits for {what}"
        self._draw()

    def on_opened(self, port: str, start: datetime) -> None:  # noqa: ARG002
        self._notice = ""

    def on_housekeeping(self, payload: bytes, time_ns: int) -> None:  # noqa: ARG002
        self._decode(payload)
        if self._dashboard.is_due:
            self._draw()

    def on_acknowledgement(self, payload: bytes, time_ns: int) -> None:  # noqa: ARG002
        self._decode(payload)

    def on_block_sent(self, block: Block) -> None:
        self._minute.add_block(block)
        self._altitude_m = float(block.measurement.position_site_m[-1, 2])
        for fault in block.faults:
            beams = f" ({', '.join(map(str, fault.beams))})" if fault.beams else ""
            row = fault.shot - int(block.measurement.shot[0])
            self._faults_due_ns[fault.kind.replace("_", " ") + beams] = block.due_ns[row]

    def on_event(self, source: EventSource, time_ns: int, what: str) -> None:  # noqa: ARG002
        self._notice = f"{time_ns * 1e-9:.3f} s: {what}"

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:
        if report.status is DeliveryStatus.SENT:
            self._sent_bytes += len(packet.payload)
            late_ns = report.sent_ns - report.due_ns
            self._recent_lateness_ns = max(self._recent_lateness_ns, late_ns)
            self._minute.add_packet(report.due_ns, late_ns, len(packet.payload))
        if self._dashboard.is_due:
            if report.status is DeliveryStatus.SENT:
                self._decode(packet.payload)
            self._draw(report.due_ns)

    def _decode(self, payload: bytes) -> None:
        arrived = unpack_frames(payload) if self._is_can else payload
        self._latest.store(self._decoder.receive(arrived))

    def _draw(self, now_ns: int = 0) -> None:
        tally, notice = self._tally, f"; {self._notice}" if self._notice else ""
        sent = f"{self._sent_bytes / 1e3:.1f} kB, {self._minute.load_bps() / 1e3:.1f} kB/s"
        lines = [
            *_time_line(self._latest, self._until),
            *self._altitude(),
            ("shots", f"{tally.sent} sent, {tally.late} late, {tally.dropped} dropped"),
            *self._lateness(),
            ("link", f"{sent}{notice}"),
            *self._latest.lines(),
        ]
        self._faults_due_ns = {
            kind: due_ns for kind, due_ns in self._faults_due_ns.items() if now_ns - due_ns < _FAULT_STAYS_NS
        }
        if self._faults_due_ns:
            lines.append(("faults", ", ".join(self._faults_due_ns)))
        if coming := next_events(self._events, now_ns * 1e-9):
            lines.append(("next", coming))
        self._dashboard.show(
            {
                "beams": self._latest.beams(),
                "scale_m": self._latest.scale_m,
                "lines": lines,
                "curves": self._minute.curves(tally.pace is Pace.WALL),
            }
        )

    def _altitude(self) -> list[Line]:
        """True altitude at the last block of shots that was sent; a bench pattern has none."""
        if math.isnan(self._altitude_m):
            return []
        return [("altitude", f"{self._altitude_m:.1f} m above the origin")]

    def _lateness(self) -> list[Line]:
        if self._tally.pace is not Pace.WALL:
            return []
        recent_ns, self._recent_lateness_ns = self._recent_lateness_ns, 0
        self._largest_lateness_ns = max(self._largest_lateness_ns, recent_ns)
        return [
            ("lateness", f"{recent_ns / 1e3:.0f} us, at most {self._largest_lateness_ns / 1e3:.0f} us so far")
        ]


_SHOWN = 3
_SAMPLES = 2000


class ScheduledEvent(NamedTuple):
    """An event at an instant of scenario time."""

    time_s: float
    what: str


def scheduled_events(
    scenario: FlightScenario | BenchScenario, trajectory: Trajectory | None
) -> list[ScheduledEvent]:
    """Events in ascending order of time; events at time 0 are left out.

    A change of pattern at an altitude is estimated by the vehicle's altitude above the origin of the site frame.

    Args:
        trajectory: its trajectory; None if it has none. Changes at an altitude of a live one are left out.
    """
    events = [*_timed_events(scenario), *_altitude_switches(scenario, trajectory)]
    return sorted(event for event in events if event.time_s > 0.0)


def next_events(events: list[ScheduledEvent], now_s: float) -> str:
    """The next events, each with the time that is left; empty after the last one."""
    coming = [event for event in events if event.time_s > now_s][:_SHOWN]
    return "; ".join(f"{event.what} in {event.time_s - now_s:.0f} s" for event in coming)


def _timed_events(scenario: FlightScenario | BenchScenario) -> Iterator[ScheduledEvent]:
    for fault in scenario.faults:
        name = fault.kind.replace("_", " ")
        if fault.at_s is not None:
            yield ScheduledEvent(fault.at_s, name)
            continue
        yield ScheduledEvent(fault.from_s, f"{name} begins")
        if fault.to_s is not None:
            yield ScheduledEvent(fault.to_s, f"{name} ends")
    if isinstance(scenario, FlightScenario):
        for switch in scenario.scanner.switches:
            if isinstance(switch, TimeSwitch):
                yield ScheduledEvent(switch.at_s, "change of pattern")


def _altitude_switches(
    scenario: FlightScenario | BenchScenario, trajectory: Trajectory | None
) -> Iterator[ScheduledEvent]:
    if trajectory is None or scenario.live or not isinstance(scenario, FlightScenario):
        return
    switches = [switch for switch in scenario.scanner.switches if isinstance(switch, AltitudeSwitch)]
    if switches:
        time_s = np.linspace(0.0, trajectory.duration_s, _SAMPLES)
        altitude_m = trajectory.state(time_s).position_site_m[:, 2]
        for switch in switches:
            below = altitude_m < switch.below_m
            if below.any():
                what = f"change of pattern below {switch.below_m:g} m"
                yield ScheduledEvent(float(time_s[below.argmax()]), what)

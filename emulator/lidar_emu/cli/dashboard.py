"""Live display on the terminal, of a run and of a listener.

A separate process draws it, so that a run never waits for the terminal: `python -m lidar_emu.cli.dashboard DESCRIPTOR`
draws what a socket receives.
"""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Self

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from lidar_emu.cli.messages import Decoder, counter_line, reason
from lidar_emu.cli.plain_console import PlainConsole
from lidar_emu.cli.scheduled_events import ScheduledEvent, next_events
from lidar_emu.cli.terminal import print_line
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.observer import EventSource, Observer
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace
from lidar_emu.runtime.summary import Tally
from lidar_emu.session import Block
from lidar_emu.transports.frames import unpack_frames
from lidar_emu.wire import rows
from lidar_protocol import Acknowledge, Interface, Message, Received

_EVERY_NS = 200_000_000
_END_LIMIT_S = 2.0
_LONGEST = 1 << 18
_NARROW, _ROOMY = 52, 70
"""Terminal widths in columns: below the first, SNR is not shown; from the second on, columns are padded."""
_WIDE = 120
"""Terminal width from which on curves are shown."""
_LABEL_WIDTH = 9
_BARS = " ▁▂▃▄▅▆▇█"
_BEAMS_SENT = 256
_SECONDS = 60
_FAULT_STAYS_NS = 1_000_000_000

Line = tuple[str, str]


class Dashboard:
    """Client of the display process: drops updates that cannot be sent at once; prints lines directly if it has died.

    The process ignores Ctrl-C: it ends, and restores the terminal, when this end of the socket is closed.
    """

    def __init__(self) -> None:
        self._clock = Clock()
        self._next_ns = 0
        self._pending: list[str] = []
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "lidar_emu.cli.dashboard", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        ours.setblocking(False)
        self._socket: socket.socket | None = ours

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        try:
            self._process.wait(_END_LIMIT_S)
        except subprocess.TimeoutExpired:  # the process hangs in a blocked terminal
            self._process.kill()
            self._process.wait()
        self._print_pending()

    @property
    def is_due(self) -> bool:
        """Whether it is time for an update."""
        return self._socket is not None and self._clock.now_ns() >= self._next_ns

    def show(self, content: dict[str, Any]) -> None:
        """Update the display; the content is described at `render`."""
        self._next_ns = self._clock.now_ns() + _EVERY_NS
        self._flush()
        self._send(content)

    def print_line(self, text: str) -> None:
        """Print a line that stays, above the display."""
        self._pending.append(text)
        self._flush()
        if self._socket is None:
            self._print_pending()

    def _flush(self) -> None:
        while self._pending and self._send({"line": self._pending[0]}):
            self._pending.pop(0)

    def _send(self, message: dict[str, Any]) -> bool:
        if self._socket is None:
            return False
        try:
            self._socket.send(json.dumps(message).encode())
        except BlockingIOError:
            return False
        except OSError:
            self._socket.close()
            self._socket = None
            self._print_pending()
            return False
        return True

    def _print_pending(self) -> None:
        pending, self._pending = self._pending, []
        for text in pending:
            print_line(text)


class LatestMessages:
    """The last messages of each unit, as rows and lines."""

    def __init__(self, interface: Interface) -> None:
        self._interface = interface
        self._shots: dict[int, Message] = {}
        self._states: dict[int, dict[str, Any]] = {}
        self._acknowledgement = ""

    def store(self, messages: Iterable[Received]) -> None:
        """Store the newest messages."""
        for message in messages:
            if isinstance(message, Acknowledge):
                self._acknowledgement = f"{message.command or 'unknown'}: {message.verdict.replace('_', ' ')}"
                continue
            if isinstance(message, Message):
                self._shots[message.unit] = message
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

    def __init__(self, dashboard: Dashboard, decoder: Decoder, title: str) -> None:
        self._dashboard, self._decoder, self._title = dashboard, decoder, title
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
            self._dashboard.show({"title": self._title, "beams": self._latest.beams(), "lines": lines})


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
        title: str,
        tally: Tally,
        duration_s: float | None,
        events: list[ScheduledEvent],
    ) -> None:
        self._events = events
        self._dashboard, self._decoder, self._is_can = dashboard, Decoder(interface), is_can
        self._latest = LatestMessages(interface)
        self._title, self._tally = title, tally
        self._until = "" if duration_s is None else f" of {duration_s:g} s"
        self._recent_lateness_ns = self._largest_lateness_ns = self._sent_bytes = 0
        self._faults_due_ns: dict[str, int] = {}
        self._notice = ""
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
                "title": self._title,
                "beams": self._latest.beams(),
                "lines": lines,
                "curves": self._minute.curves(tally.pace is Pace.WALL),
            }
        )

    def _lateness(self) -> list[Line]:
        if self._tally.pace is not Pace.WALL:
            return []
        recent_ns, self._recent_lateness_ns = self._recent_lateness_ns, 0
        self._largest_lateness_ns = max(self._largest_lateness_ns, recent_ns)
        return [
            ("lateness", f"{recent_ns / 1e3:.0f} us, at most {self._largest_lateness_ns / 1e3:.0f} us so far")
        ]


def main(descriptor: int) -> None:
    """Draw until the other end of the socket is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    console = PlainConsole()
    with (
        socket.socket(fileno=descriptor) as receiver,
        Live(console=console, auto_refresh=False, transient=True, vertical_overflow="crop") as live,
    ):
        while message := receiver.recv(_LONGEST):
            content = json.loads(message)
            if "line" in content:
                console.print(content["line"], highlight=False, soft_wrap=True)
            else:
                live.update(render(content, console.width, console.height), refresh=True)


def render(content: dict[str, Any], width: int, height: int) -> RenderableType:
    """The display for a terminal of this size.

    Args:
        content: `title`; `beams`: name, range in m, closing speed in m/s, SNR in dB, reason if invalid or None;
            `lines`: label and text; `curves`: label, values from 0 to 1 of the last 60 seconds, and text, shown on a
            wide terminal.
        width: in columns.
        height: in rows.
    """
    lines: Sequence[tuple[str, str]] = content["lines"]
    if width >= _WIDE:
        curves = content.get("curves", ())
        lines = [*lines, *((label, f"{_bars(values)}  {text}") for label, values, text in curves)]
    room = max(1, height - len(lines) - 5)
    beams, rest = content["beams"][:room], content["beams"][room:]
    table = Table(box=None, pad_edge=False, padding=(0, 2 if width >= _ROOMY else 1, 0, 0))
    for heading in ("beam", "range m", "speed m/s", *(("SNR dB",) if width >= _NARROW else ())):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("state", no_wrap=True, overflow="ellipsis")
    for name, range_m, speed_mps, snr_db, why in beams:
        numbers = [_number(range_m, ".3f"), _number(speed_mps, "+.4f")]
        if width >= _NARROW:
            numbers.append(_number(snr_db, ".1f"))
        table.add_row(Text(name), *numbers, Text(why or "valid", style="yellow" if why else "green"))
    more = [Text(f"and {len(rest)} beams more", style="dim")] if rest else []
    below = [
        _one_row(
            Text.assemble((f"{label:<{_LABEL_WIDTH}} ", "dim"), (text, "red" if label == "faults" else ""))
        )
        for label, text in lines
    ]
    return Group(_one_row(Text(content["title"], style="bold")), table, *more, Text(), *below)


def _bars(values: Sequence[float]) -> str:
    steps = len(_BARS) - 1
    return "".join(_BARS[round(steps * min(max(value, 0.0), 1.0))] for value in values).rjust(_SECONDS)


def _number(value: float | None, how: str) -> str:
    return "-" if value is None else format(value, how)


def _one_row(text: Text) -> Text:
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


if __name__ == "__main__":
    main(int(sys.argv[1]))

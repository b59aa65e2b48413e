"""The port process: it owns the port, sends packets when they are due, and counts what arrives. It imports little.

`PortRunner` starts it with the control pipe as standard input: at its end of file the process closes the port and ends,
however the model process ended; in mid-run the other end has half a second to fetch what was sent. Unless the
model process announced an orderly end, no further packet is sent but the final message, if there is one.
Both pipes carry one JSON object per line:

    in   {"port": ..., "packets": fd, "reports": fd, "doorbell": fd, "faults": [a PortFault] or null}
                                                     once; also "loopback": fd, "stderr": fd, and
                                                     "absent": true if the other end need not listen yet
         {"realtime": true}                          request privileges: packets will go out when they are due
         {"begin": {"start_ns": ..., "late_after_ns": ..., "pace": ..., "when_late": ..., "poll_ns": ...}}
         {"fault": a PortFault}                      one more, if there was a list at the start
         {"finish": true}                            no more packets will follow
         {"supersede": [generation, shot, number]}   do not send older packets from this shot, before that entry
         {"send": hex}                               send at once; not a shot
         {"poll": true}                              send the packet that waits for a poll
         {"pulses": [first_ns, period_ns, [[shot, divisor]]]}    when to give pulses, see `PulseTrain`
         {"final_message": hex}                      to be sent if the model process dies
         {"end": is orderly}                         before the end of file, unless the model process died
    out  {"ready": description} or {"refused": [where, key, value, remedy]}
         {"connected": is connected}                 before the run begins, at first and at every change
         {"granted": [name], "missing": {name: command}}     privileges, if requested, once the run begins
         {"received": [time_ns, hex, pulse_ns]}      arrived on the port, and when the last pulse came, or null; lost
                                                     while the model process does not read
         {"between": [time_ns or null]}              when payloads of "send" were sent, in their order; null: not sent
         {"completed": count}                        in lockstep: number of packets whose delivery status is final
         {"event": [number, time_ns, text]}          counted from 1; lost while the model process does not read
         {"finished": counts}                        every packet has its report
         {"stopped": counts, "events": count}        last line; events that were lost count too
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lidar_emu.errors import InputError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.exchange import ControlPipe, SharedRing, StatusPipe
from lidar_emu.runtime.port.packets import WAKE_UP, Pace, Pacing, WhenLate
from lidar_emu.runtime.port.sender import Sender, Wait
from lidar_emu.runtime.realtime_priority import RealtimePrivileges, request_realtime
from lidar_emu.transports.link import COUNTED, DeliveryStatus, Link
from lidar_emu.transports.opening import Opener, opener
from lidar_emu.transports.pulses import PpsDevice, PulseTrain
from lidar_emu.transports.spec import PortSpec, drain_time_s

if TYPE_CHECKING:
    from lidar_emu.transports.faulty_link import FaultyPort

_FULL_LINE_LIMIT_NS = 500_000_000
_RETRY_NS = 1_000_000
RESULT_TEXTS = {
    DeliveryStatus.SENT: "sent",
    DeliveryStatus.DROPPED_FULL: "not sent: the line is full",
    DeliveryStatus.DROPPED_NOBODY: "not sent: nobody is connected",
    DeliveryStatus.DROPPED_BROKEN: "not sent: the link is broken",
}
"""Delivery status of the final message, for the user."""


def send_final_message(link: Link, message: bytes, clock: Clock) -> DeliveryStatus:
    """Send the final message after what the line has taken already; a full line gets half a second."""
    gives_up_ns = clock.now_ns() + _FULL_LINE_LIMIT_NS
    while True:
        now_ns = clock.now_ns()
        link.service(now_ns)
        status = link.send(message, now_ns)
        if status is not DeliveryStatus.DROPPED_FULL or now_ns >= gives_up_ns:
            return status
        clock.wait(now_ns + _RETRY_NS)


def write_error(descriptor: int, text: str, clock: Clock) -> None:
    """Write a line to the standard error of the dead process, unless that would have to wait."""
    with suppress(OSError):
        if clock.wait(clock.now_ns(), [], [descriptor])[1]:
            os.write(descriptor, f"lidar-emu: {text}\n".encode())


_CONTROL, _STATUS = 0, 1
_PIPE_BYTES = 65536
_DRAIN_NS = 2_000_000_000
_SHORT_DRAIN_NS = 500_000_000
_EMPTY_NS = 20_000_000
"""How long a line must look empty."""
_POLL_NS = 5_000_000
_WAKE_UP_NS = 1_000_000
"""Longest busy wait for the announced packet."""
# A host that floods the port is read no faster than a line of 2.5 Mbit/s would deliver. The rest of the time belongs to
# the shots, and the system delays a process that never sleeps.
_READ_NS_PER_BYTE = 4_000


def main() -> None:
    """Run until the control pipe ends."""
    # Ctrl-C in a terminal goes to the whole process group; the model process handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    own_port(_CONTROL, _STATUS, Clock(), opener, request_realtime)


def own_port(
    control_descriptor: int,
    status_descriptor: int,
    clock: Clock,
    opener_of: Callable[[PortSpec, int | None, Callable[[], int]], Opener],
    request: Callable[[], RealtimePrivileges],
) -> None:
    """Open the port and send on it until the control pipe ends.

    Args:
        opener_of: `lidar_emu.transports.opening.opener`.
        request: requests real-time privileges.
    """
    control = ControlPipe(control_descriptor)
    settings = control.receive_first()
    if settings is None:
        return
    status = StatusPipe(status_descriptor, clock)
    spec = PortSpec.from_json(settings["port"])
    open_port = opener_of(spec, settings.get("loopback"), clock.now_ns)
    faulty = None
    if settings["faults"] is not None:
        from lidar_emu.transports.faulty_link import FaultyPort

        faulty = FaultyPort(open_port, spec, clock.now_ns)
        for fault in settings["faults"]:
            faulty.add(fault)
    try:
        is_pps = spec.pulse_line.startswith("/dev/")
        pps = PpsDevice(spec.pulse_line, clock.utc_ahead_ns) if is_pps else None
        link = Link(faulty or open_port, str(spec) if settings["absent"] else None)
    except InputError as error:
        value = error.value if isinstance(error.value, str | int | float | None) else str(error.value)
        status.send(refused=[error.where, error.key, value, error.remedy])
        status.close()
        return
    os.set_blocking(control_descriptor, False)
    status.send(ready=link.description)
    try:
        with SharedRing(settings["packets"]) as packets, SharedRing(settings["reports"]) as reports:
            error_text = _PortLoop(
                spec,
                link,
                packets,
                reports,
                settings["doorbell"],
                control,
                status,
                clock,
                faulty,
                request,
                pps,
            ).run()
    finally:
        link.close()
    if error_text is not None and "stderr" in settings:
        write_error(settings["stderr"], error_text, clock)


@dataclass
class _PortLoop:
    """The loop of the process: do what is due, then sleep until the next event."""

    _spec: PortSpec
    _link: Link
    _packets: SharedRing
    _reports: SharedRing
    _doorbell: int
    _control: ControlPipe
    _status: StatusPipe
    _clock: Clock
    _faulty: FaultyPort | None
    _request: Callable[[], RealtimePrivileges]
    _pps: PpsDevice | None
    _sender: Sender | None = None
    _pulses: PulseTrain | None = None
    _reads_again_ns: int = 0
    _received_bytes: int = 0
    _rx_overrun_bytes: int = 0
    _unscheduled_bytes: int = 0
    _tx_dropped: int = 0
    _is_lockstep: bool = False
    _reported_connected: bool | None = None
    _reported_completed: int = 0
    _event_count: int = 0
    _privileges: RealtimePrivileges | None = None
    _finishing: bool = False
    _drain: _Drain | None = None
    _final_message: bytes = b""
    _end_is_orderly: bool | None = None

    def run(self) -> str | None:
        """Run until the control pipe ends; return an error message if the model process died."""
        is_open = True
        while is_open:
            self._give_pulse()
            # What the process woke up for comes first. Whether a reader is connected was checked before it slept,
            # and a change would have woken it.
            wait = self._sender.step() if self._sender is not None else Wait()
            self._link.service(self._clock.now_ns())
            self._report_events()
            self._report_connected()
            self._report_completed()
            self._report_between()
            drain_ns = self._drain_until_ns(wait)
            self._status.flush()
            is_open = self._sleep(wait, drain_ns)
        return self._end()

    def _give_pulse(self) -> None:
        if self._pulses is not None and (level := self._pulses.step(self._clock.now_ns())) is not None:
            self._link.set_pulse(level)

    def _end(self) -> str | None:
        error = "the model process died: the run has ended" if self._end_is_orderly is None else None
        if self._final_message and not self._end_is_orderly:
            status = send_final_message(self._link, self._final_message, self._clock)
            error = error and f"{error}, final message {RESULT_TEXTS[status]}"
            self._drain_briefly()
        elif self._sender is not None and (self._drain is None or self._finishing):
            self._drain_briefly()
        self._status.send(stopped=self._counts(), events=self._event_count)
        self._status.close()
        return error

    def _sleep(self, wait: Wait, drain_ns: int | None) -> bool:
        """Sleep until the next event, and read what arrived; False at the end of the control pipe."""
        now_ns = self._clock.now_ns()
        reads = now_ns >= self._reads_again_ns
        readable = self._link.readable if reads else []
        reads_again_ns = None if reads else self._reads_again_ns
        pulse_ns = None if self._pulses is None else self._pulses.wake_ns
        wakes_ns = (
            wait.until_ns,
            drain_ns,
            reads_again_ns,
            self._link.wake_ns(now_ns, wait.for_room),
            pulse_ns,
        )
        until_ns = min((wake_ns for wake_ns in wakes_ns if wake_ns is not None), default=None)
        doorbells = [self._doorbell] if wait.for_packets else []
        needs_room = wait.for_room or self._link.pending
        ready, _ = self._clock.wait(
            until_ns,
            [self._control.descriptor, *doorbells, *readable],
            [*self._status.writable, *(self._link.writable if needs_room else [])],
        )
        if self._doorbell in ready and os.read(self._doorbell, _PIPE_BYTES).endswith(WAKE_UP):
            self._send_announced()
        # Without a descriptor to wait on, the link is read in every round.
        if reads and (not readable or readable[0] in ready):
            self._receive()
        if self._control.descriptor not in ready:
            return True
        messages, is_open = self._control.receive()
        for message in messages:
            self._execute(message)
        return is_open

    def _send_announced(self) -> None:
        """Wait busily for a packet, polling the ring alone: to poll a terminal may take longer than a shot."""
        sender, gives_up_ns = self._sender, self._clock.now_ns() + _WAKE_UP_NS
        completed = -1 if sender is None else sender.completed
        while sender is not None and sender.step().for_packets and sender.completed == completed:
            self._give_pulse()
            if self._clock.now_ns() >= gives_up_ns:
                return

    def _execute(self, message: dict[str, Any]) -> None:
        if "realtime" in message:
            self._privileges = self._request()
        if "begin" in message:
            self._begin(message["begin"])
        if "fault" in message and self._faulty is not None:
            self._faulty.add(message["fault"])
        if "finish" in message:
            self._finishing = True
        self._final_message = bytes.fromhex(message.get("final_message", "")) or self._final_message
        self._end_is_orderly = message.get("end", self._end_is_orderly)
        if "send" in message:
            self._send_now(bytes.fromhex(message["send"]))
        if "poll" in message and self._sender is not None:
            self._sender.poll()
        if "pulses" in message:
            first_ns, period_ns, firing = message["pulses"]
            self._pulses = self._pulses or PulseTrain(first_ns, period_ns)
            self._pulses.use(firing)
        if "supersede" in message and self._sender is not None:
            self._sender.supersede(*message["supersede"])

    def _begin(self, begin: dict[str, Any]) -> None:
        if self._faulty is not None:
            self._faulty.begin(begin["start_ns"])
        pace, when_late = Pace(begin["pace"]), WhenLate(begin["when_late"])
        pacing = Pacing(pace, begin["late_after_ns"], when_late, begin["poll_ns"])
        self._is_lockstep = pacing.pace is Pace.LOCKSTEP
        if (system := self._privileges) is not None:
            driver = self._link.driver_features
            self._status.send(
                granted=[*system.granted, *driver.granted], missing={**system.missing, **driver.missing}
            )
        self._sender = Sender(
            self._packets, self._reports, self._link, self._clock, begin["start_ns"], pacing
        )

    def _send_now(self, payload: bytes) -> None:
        """Send a payload that is not a shot; before the run begins, send or drop it at once."""
        if self._sender is not None:
            self._sender.send_between(payload)
        elif self._link.send(payload, self._clock.now_ns()) is DeliveryStatus.SENT:
            self._unscheduled_bytes += len(payload)
            self._status.send(between=[self._clock.now_ns()])
        else:
            self._tx_dropped += 1
            self._status.send(between=[None])

    def _drain_until_ns(self, wait: Wait) -> int | None:
        """Report when all packets are out and read; while the other end still reads, return the next poll."""
        if not self._finishing or not wait.for_packets:
            return None
        now_ns = self._clock.now_ns()
        unread = self._link.unread
        if self._drain is None:
            self._drain = _Drain(now_ns, _DRAIN_NS + round(drain_time_s(self._spec, unread) * 1e9))
        if not self._drain.is_over(bool(self._link.pending or unread), now_ns):
            return now_ns + _EMPTY_NS
        self._finishing = False
        self._status.send(finished=self._counts())
        return None

    def _drain_briefly(self) -> None:
        """Let the other end read what counts as sent, even if the rest of the run is cut off."""
        now_ns = self._clock.now_ns()
        drain = _Drain(now_ns, _SHORT_DRAIN_NS)
        while not drain.is_over(bool(self._link.pending or self._link.unread), now_ns):
            self._clock.wait(now_ns + _POLL_NS)
            now_ns = self._clock.now_ns()
            self._link.service(now_ns)
            self._receive()
        self._report_events()

    def _receive(self) -> None:
        now_ns = self._clock.now_ns()
        data = self._link.receive(now_ns)
        self._reads_again_ns = now_ns + _READ_NS_PER_BYTE * len(data)
        self._received_bytes += len(data)
        if data and not self._status.send_if_idle(received=[now_ns, data.hex(), self._pulse_ns()]):
            self._rx_overrun_bytes += len(data)

    def _pulse_ns(self) -> int | None:
        """When the last synchronisation pulse began."""
        if self._pps is None:
            return self._link.pulse_ns
        failed, pulse_ns = self._pps.failure, self._pps.last_ns()
        if self._pps.failure is not None and failed is None:
            self._link.add_event(self._pps.failure, self._clock.now_ns())
        return pulse_ns

    def _report_events(self) -> None:
        for time_ns, text in self._link.take_events():
            self._event_count += 1
            self._status.send_if_idle(event=[self._event_count, time_ns, text])

    def _report_connected(self) -> None:
        """Report whether the other end has opened the port, as long as the run may wait for that."""
        if self._sender is None and self._link.connected is not self._reported_connected:
            self._reported_connected = self._link.connected
            self._status.send(connected=self._reported_connected)

    def _report_completed(self) -> None:
        """Report completed packets in lockstep, where the model process waits for them, as the simulator does."""
        completed = self._sender.completed if self._sender is not None and self._is_lockstep else 0
        if completed != self._reported_completed:
            self._reported_completed = completed
            self._status.send(completed=completed)

    def _report_between(self) -> None:
        if self._sender is not None and self._sender.between_ns:
            between_ns, self._sender.between_ns = self._sender.between_ns, []
            self._status.send(between=between_ns)

    def _counts(self) -> dict[str, int]:
        sender = self._sender
        sent_bytes, dropped = (sender.sent_bytes, sender.dropped_between) if sender is not None else (0, 0)
        return {
            "sent_bytes": self._unscheduled_bytes + sent_bytes,
            "unread_bytes": self._link.unread,
            "received_bytes": self._received_bytes,
            "rx_overrun_bytes": self._rx_overrun_bytes,
            "tx_dropped": self._tx_dropped + dropped,
            "pulses": 0 if self._pulses is None else self._pulses.count,
            "pulse_delay_max_ns": 0 if self._pulses is None else self._pulses.latest_ns,
            **{name: self._link.counts[name] for name in COUNTED},
        }


class _Drain:
    """The time at the end in which the other end still reads what was sent; it begins at once."""

    def __init__(self, now_ns: int, limit_ns: int) -> None:
        self._ends_ns = now_ns + limit_ns
        self._busy_ns = now_ns

    def is_over(self, is_busy: bool, now_ns: int) -> bool:
        """Whether the line is empty, or the time limit has passed."""
        if is_busy:
            self._busy_ns = now_ns
        # For a moment, bytes on their way through a pty are counted nowhere: the line must look empty for a while.
        return now_ns - self._busy_ns >= _EMPTY_NS or now_ns >= self._ends_ns


if __name__ == "__main__":
    main()

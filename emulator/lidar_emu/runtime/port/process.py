"""The process that owns the port. It sends what is due and counts what arrives; it imports little.

Started by `PortRunner` with a pipe as standard input, which is its lifeline: at the end of file it closes the
port and ends, however the parent ended; in mid-run the other end has half a second to fetch what was sent. Unless the
parent had hung up in order, it sends nothing more of what it was given but final message, if it has any.
Both pipes carry one JSON object per line:

    in   {"port": ..., "packets": fd, "reports": fd, "doorbell": fd, "faults": [a PortFault] or null}
                                                     once; also "loopback": fd, "complaints": fd
         {"begin": {"start_ns": ..., "late_after_ns": ..., "pace": ..., "when_late": ...}}    monotonic clock
         {"fault": a PortFault}                      one more, if there was a list at the start
         {"finish": true}                            no more packets will come
         {"supersede": [generation, shot, number]}   older packets from this shot, before that entry: not to be sent
         {"send": hex}                               at once; it is no shot
         {"final_message": hex}                         to be sent if the parent dies
         {"end": in order}                           before the end of file, unless the parent died; or false: it fails
    out  {"ready": description} or {"refused": [where, key, value, allowed]}
         {"granted": [name], "missing": {name: command}}     what the system gave towards punctuality
         {"arrived": [time_ns, hex, pulse_ns]}       received on the port, and when the last pulse came, or null; lost
                                                     while the parent does not listen
         {"settled": count}                          in lockstep: number of packets whose delivery status is known
         {"event": [number, time_ns, text]}          counted from 1; lost while the parent does not listen
         {"finished": counts}                        every packet has its report
         {"stopped": counts}                         last line
"""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING, Any

from lidar_emu.errors import InputError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.answers import Answers
from lidar_emu.runtime.port.control_pipe import ControlPipe
from lidar_emu.runtime.port.drain import SETTLE_NS, Drain
from lidar_emu.runtime.port.pacing import Pace, Pacing, WhenLate
from lidar_emu.runtime.port.packets import ALERT
from lidar_emu.runtime.port.parent_death import complain, send_final_message, told_of
from lidar_emu.runtime.port.ring import Ring
from lidar_emu.runtime.port.sender import Sender, Wait
from lidar_emu.runtime.realtime import request_realtime
from lidar_emu.transports.link import COUNTED, DeliveryStatus, Link
from lidar_emu.transports.opening import Opener, opener
from lidar_emu.transports.spec import PortSpec
from lidar_emu.transports.wire_load import drain_time_s

if TYPE_CHECKING:
    from lidar_emu.transports.faulty_link import FaultyPort

_LIFELINE, _PARENT = 0, 1
_PIPE_BYTES = 65536
_DRAIN_NS = 2_000_000_000
_HASTY_DRAIN_NS = 500_000_000
_LOOK_AGAIN_NS = 5_000_000
_ALERT_NS = 1_000_000
"""How long the packet that was announced is waited for without sleeping."""
# A host that floods the port is heard no faster than a line of 2.5 Mbit/s would bring it. The rest of the time belongs
# to the shots, and a process that never sleeps is one that the system makes wait.
_LISTEN_NS_PER_BYTE = 4_000


def main() -> None:
    """Run until the lifeline ends."""
    # Ctrl-C in a terminal goes to the whole group; what it means is the parent's business.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    lifeline = ControlPipe(_LIFELINE)
    settings = lifeline.next_blocking()
    if settings is None:
        return
    clock = Clock()
    answers = Answers(_PARENT, clock)
    spec = PortSpec.from_json(settings["port"])
    open_port = opener(spec, settings.get("loopback"), clock.now_ns)
    faulty = None if settings["faults"] is None else _faulty(open_port, spec, settings["faults"], clock)
    try:
        link = Link(faulty or open_port)
    except InputError as error:
        answers.say(refused=[error.where, error.key, _plain(error.value), error.allowed])
        answers.end()
        return
    os.set_blocking(_LIFELINE, False)
    answers.say(ready=link.description)
    try:
        with Ring(settings["packets"]) as packets, Ring(settings["reports"]) as reports:
            complaint = _Port(
                spec, link, packets, reports, settings["doorbell"], lifeline, answers, clock, faulty
            ).run()
    finally:
        link.close()
    if complaint is not None and "complaints" in settings:
        complain(settings["complaints"], complaint, clock)


class _Port:
    """The loop: do what is due, then sleep until something else is."""

    def __init__(
        self,
        spec: PortSpec,
        link: Link,
        packets: Ring,
        reports: Ring,
        doorbell: int,
        lifeline: ControlPipe,
        answers: Answers,
        clock: Clock,
        faulty: FaultyPort | None,
    ) -> None:
        self._spec = spec
        self._link = link
        self._packets = packets
        self._reports = reports
        self._doorbell = doorbell
        self._lifeline = lifeline
        self._answers = answers
        self._clock = clock
        self._faulty = faulty
        self._sender: Sender | None = None
        self._listens_again_ns = 0
        self._received_bytes = 0
        self._unheard_bytes = 0
        self._said_bytes = 0
        self._unsent = 0
        self._lockstep = False
        self._told_settled = 0
        self._event_count = 0
        self._alert_until_ns = 0
        self._finishing = False
        self._drain: Drain | None = None
        self._final_message = b""
        self._ends_in_order: bool | None = None

    def run(self) -> str | None:
        """Until the lifeline ends; returns what the user is to be told if the parent has died."""
        alive = True
        while alive:
            # First what the process woke up for. Whether somebody is at the other end was seen before it slept, and
            # would have woken it if it had changed.
            wait = self._sender.step() if self._sender is not None else Wait()
            self._link.service(self._clock.now_ns())
            self._tell_events()
            self._tell_settled()
            drain_ns = self._drained_or_look_again(wait)
            self._answers.flush()
            alive = self._sleep(wait, drain_ns)
        complaint = "the model's process died: the run has ended" if self._ends_in_order is None else None
        if self._final_message and not self._ends_in_order:
            status = send_final_message(self._link, self._final_message, self._clock)
            complaint = complaint and f"{complaint}, final message {told_of(status)}"
            self._drain_in_haste()
        elif self._sender is not None and (self._drain is None or self._finishing):
            self._drain_in_haste()
        self._answers.say(stopped=self._counts())
        self._answers.end()
        return complaint

    def _sleep(self, wait: Wait, drain_ns: int | None) -> bool:
        """Sleep until something is to be done, and take what arrived; False at the end of the lifeline."""
        now_ns = self._clock.now_ns()
        listens = now_ns >= self._listens_again_ns
        readable = self._link.readable if listens else []
        listens_again_ns = None if listens else self._listens_again_ns
        wakes_ns = (wait.until_ns, drain_ns, listens_again_ns, self._link.wake_ns(now_ns, wait.for_room))
        until_ns = min((wake_ns for wake_ns in wakes_ns if wake_ns is not None), default=None)
        doorbells = [self._doorbell] if wait.for_packets else []
        wants_room = wait.for_room or self._link.pending
        alert = wait.for_packets and self._alert_until_ns > self._clock.now_ns()
        ready, _ = self._clock.wait(
            self._alert_until_ns if alert else until_ns,
            [_LIFELINE, *doorbells, *readable],
            [*self._answers.writable, *(self._link.writable if wants_room else [])],
            awake=alert,
        )
        if self._doorbell in ready:
            alerted = os.read(self._doorbell, _PIPE_BYTES).endswith(ALERT)
            self._alert_until_ns = self._clock.now_ns() + _ALERT_NS if alerted else 0
        # Without a descriptor to watch, arrivals are looked for on every round.
        if listens and (not readable or readable[0] in ready):
            self._receive()
        return _LIFELINE not in ready or self._lifeline.obey(self._obey)

    def _obey(self, order: dict[str, Any]) -> None:
        if "begin" in order:
            begin = order["begin"]
            if self._faulty is not None:
                self._faulty.begin(begin["start_ns"])
            pacing = Pacing(Pace(begin["pace"]), begin["late_after_ns"], WhenLate(begin["when_late"]))
            self._lockstep = pacing.pace is Pace.LOCKSTEP
            if pacing.pace is Pace.WALL:
                had = request_realtime()
                driver_features = self._link.driver_features
                self._answers.say(
                    granted=[*had.granted, *driver_features.granted],
                    missing={**had.missing, **driver_features.missing},
                )
            self._sender = Sender(
                self._packets, self._reports, self._link, self._clock, begin["start_ns"], pacing
            )
        if "fault" in order and self._faulty is not None:
            self._faulty.order(order["fault"])
        if "finish" in order:
            self._finishing = True
        self._final_message = bytes.fromhex(order.get("final_message", "")) or self._final_message
        self._ends_in_order = order.get("end", self._ends_in_order)
        if "send" in order:
            self._say(bytes.fromhex(order["send"]))
        if "supersede" in order and self._sender is not None:
            self._sender.supersede(*order["supersede"])

    def _say(self, payload: bytes) -> None:
        """Send or drop at once what is no shot, also before the run begins."""
        if self._link.send(payload, self._clock.now_ns()) is DeliveryStatus.SENT:
            self._said_bytes += len(payload)
        else:
            self._unsent += 1

    def _drained_or_look_again(self, wait: Wait) -> int | None:
        """Say so once everything is out; while the other end still reads, when to look again."""
        if not self._finishing or not wait.for_packets:
            return None
        now_ns = self._clock.now_ns()
        unread = self._link.unread
        if self._drain is None:
            self._drain = Drain(now_ns, _DRAIN_NS + round(drain_time_s(self._spec, unread) * 1e9))
        if not self._drain.is_over(bool(self._link.pending or unread), now_ns):
            return now_ns + SETTLE_NS
        self._finishing = False
        self._answers.say(finished=self._counts())
        return None

    def _drain_in_haste(self) -> None:
        """What counts as sent should arrive, even where nobody cares for the rest of the run."""
        now_ns = self._clock.now_ns()
        drain = Drain(now_ns, _HASTY_DRAIN_NS)
        while not drain.is_over(bool(self._link.pending or self._link.unread), now_ns):
            self._clock.wait(now_ns + _LOOK_AGAIN_NS)
            now_ns = self._clock.now_ns()
            self._link.service(now_ns)
            self._receive()
        self._tell_events()

    def _receive(self) -> None:
        now_ns = self._clock.now_ns()
        data = self._link.receive(now_ns)
        self._listens_again_ns = now_ns + _LISTEN_NS_PER_BYTE * len(data)
        self._received_bytes += len(data)
        if data and not self._answers.mention(arrived=[now_ns, data.hex(), self._link.pulse_ns]):
            self._unheard_bytes += len(data)

    def _tell_events(self) -> None:
        for time_ns, text in self._link.take_events():
            self._event_count += 1
            self._answers.mention(event=[self._event_count, time_ns, text])

    def _tell_settled(self) -> None:
        """Where a simulator waits for the packets to be out, so does the parent."""
        if self._lockstep and self._sender is not None and self._sender.settled != self._told_settled:
            self._told_settled = self._sender.settled
            self._answers.say(settled=self._told_settled)

    def _counts(self) -> dict[str, int]:
        sent_bytes = self._said_bytes + (self._sender.sent_bytes if self._sender is not None else 0)
        return {
            "sent_bytes": sent_bytes,
            "received_bytes": self._received_bytes,
            "rx_overrun_bytes": self._unheard_bytes,
            "unsent": self._unsent,
            **{name: self._link.counts[name] for name in COUNTED},
        }


def _faulty(open_port: Opener, spec: PortSpec, faults: list[dict[str, Any]], clock: Clock) -> FaultyPort:
    from lidar_emu.transports.faulty_link import FaultyPort

    port = FaultyPort(open_port, spec, clock.now_ns)
    for fault in faults:
        port.order(fault)
    return port


def _plain(value: object) -> object:
    return value if isinstance(value, str | int | float | None) else str(value)


if __name__ == "__main__":
    main()

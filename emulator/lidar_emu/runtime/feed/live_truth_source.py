"""Truth from a simulator: received, checked, passed to the observers, counted."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any, NamedTuple

from lidar_emu.errors import InputError, reason_of
from lidar_emu.ip_addresses import endpoint
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket
from lidar_emu.runtime.port.status import EventLog, events_to_json
from lidar_emu.runtime.summary import LatenessHistogram
from lidar_emu.trajectory.live_datagram import Answer, Truth, Verdict, sequence_of
from lidar_emu.transports.sockets import AT_ONCE, DatagramSocket

if TYPE_CHECKING:
    from lidar_emu.trajectory.live import LiveTrajectory


class TruthSenders:
    """Believes the simulators that the scenario allows, or else the sender of the first truth.

    A sender is the address that a datagram socket reports: (host, port, ...), or the path of a Unix socket.

    Args:
        allow: IP addresses, with or without a port; empty: the sender of the first truth alone.
    """

    def __init__(self, allow: Sequence[str]) -> None:
        self._allowed = [endpoint(text) for text in allow]
        self._first: Any = None
        self.ignored = 0
        """Datagrams of senders that are not believed."""

    def believes(self, sender: Any) -> bool:
        """Whether a datagram of this sender counts; counts it otherwise."""
        if self._allowed:
            host, port = ip_address(sender[0]), sender[1]
            believed = any(
                host == ip_address(each.host) and each.port in (None, port) for each in self._allowed
            )
        else:
            believed = self._first is None or sender == self._first
        self.ignored += not believed
        return believed

    def accepted(self, sender: Any) -> None:
        """Note that a truth of this sender was accepted."""
        if self._first is None:
            self._first = sender

    @property
    def believed(self) -> str:
        """Who is believed, for the user."""
        return sender_name(self._first)


def sender_name(sender: Any) -> str:
    """A sender's address for the user, such as 127.0.0.1:5601."""
    if not isinstance(sender, tuple):
        return sender or "a socket without a name"
    host, port = sender[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


_EARLY_DATAGRAMS = 1000
"""Limit on datagrams from before the run that are passed to the observers once it has begun."""


def truth_socket(address: str, machine: Machine) -> DatagramSocket:
    """The socket on which a simulator's truth arrives.

    Raises:
        InputError: the address cannot be bound.
    """
    try:
        return machine.datagram_socket(address)
    except (OSError, ValueError) as error:
        remedy = f"must be a free address, udp:HOST:PORT or unix:PATH: {reason_of(error)}"
        raise InputError("trajectory", "listen", address, remedy) from None


class ReceivedTruth(NamedTuple):
    """A datagram of truth, valid or not."""

    truth: Truth | None
    """None: the datagram is malformed."""
    verdict: Verdict
    sequence: int
    """Sequence number, if there is one."""
    arrived_ns: int
    """Instant of the monotonic clock."""
    sender: Any
    """Address of the sender."""


class TruthSource(Observer):
    """Feeds a live trajectory from a socket, and measures the response: from truth to the last byte of its packet.

    Args:
        stale_after_ns: age above which truth is stale.
        allow: simulators that are believed; see `TruthSenders`.
        observers: receive every datagram of theirs, when there is time.
    """

    def __init__(
        self,
        socket: DatagramSocket,
        trajectory: LiveTrajectory,
        stale_after_ns: int,
        allow: Sequence[str],
        observers: Sequence[Observer],
    ) -> None:
        self._socket = socket
        self._trajectory = trajectory
        self._stale_after_ns = stale_after_ns
        self._senders = TruthSenders(allow)
        self._observers = observers
        self._events = EventLog()
        self._new_events: list[tuple[int, str]] = []
        self._age = LatenessHistogram()
        self._stale = 0
        self._undelivered = 0
        self._response = LatenessHistogram()
        self._unreported_shots: deque[tuple[int, int]] = deque()
        self.ended = False
        """Whether the last truth of the flight has arrived."""
        self._start_ns: int | None = None
        self._begun = False
        self._ended_by: str | None = None
        self._unreported: list[tuple[bytes, int, int, bool]] = []
        self.newest_arrived_ns = 0
        """Instant of the monotonic clock."""

    def fileno(self) -> int:
        """Ready when something arrived."""
        return self._socket.fileno()

    def receive(self, most: int = AT_ONCE) -> list[ReceivedTruth]:
        """Process at most `most` datagrams, and return those of senders that are believed."""
        received = []
        for data, arrived_ns, sender in self._socket.receive(most):
            if self._senders.believes(sender):
                received.append(self._check(data, arrived_ns, sender))
            elif self._senders.ignored == 1:
                what = f"truth of {sender_name(sender)} is ignored: {self._senders.believed} is believed"
                self._happened(arrived_ns, what)
        return received

    def warm_up(self) -> None:
        """Process the newest truth once more, without consequence, to fill the processor's caches."""
        newest = None if self.newest is None else Truth.from_bytes(self.newest.to_bytes())
        if newest is not None:
            self._trajectory.warm_up(newest)

    def expect(self, start_ns: int) -> None:
        """Set scenario time 0 to this instant of the monotonic clock, before the first truth arrives."""
        self._start_ns = start_ns

    def begin(self, start_ns: int | None) -> None:
        """Begin the run.

        Args:
            start_ns: instant of the monotonic clock at scenario time 0; None in lockstep.
        """
        self._start_ns, self._begun = start_ns, True

    def notify(self) -> None:
        """Pass new datagrams to the observers. Call it once the run has begun, while no shot waits."""
        unreported, self._unreported = self._unreported, []
        for data, arrived_ns, lockstep_ns, counted in unreported:
            time_ns = lockstep_ns if self._start_ns is None else arrived_ns - self._start_ns
            for observer in self._observers:
                observer.on_truth(data, max(0, time_ns), counted)
        new_events, self._new_events = self._new_events, []
        for time_ns, what in new_events:
            for observer in self._observers:
                observer.on_event("truth", time_ns, what)

    def answer(self, parts: Sequence[Answer], receiver: Any) -> None:
        """Answer the sender of a datagram; answers that cannot be delivered are counted."""
        for part in parts:
            self._undelivered += not self._socket.answer(part.to_bytes(), receiver)

    @property
    def newest(self) -> Truth | None:
        """The newest accepted truth; None before the first."""
        return self._trajectory.newest

    def covers(self, time_ns: int) -> bool:
        """Whether truth reaches up to a scenario time."""
        newest = self.newest
        return newest is not None and newest.time_ns >= time_ns

    def is_fresh_at(self, time_ns: int) -> bool:
        """Whether truth is not stale for a shot valid at this scenario time."""
        return self._age_ns(time_ns) <= self._stale_after_ns

    def used_for(self, packet: OutgoingPacket, time_ns: int) -> None:
        """Note that a packet, of a shot valid at this scenario time, was made from the newest truth."""
        age_ns = self._age_ns(time_ns)
        self._age.add(age_ns)
        self._stale += age_ns > self._stale_after_ns
        assert self._start_ns is not None
        accepted = self._trajectory.verdicts[Verdict.ACCEPTED]
        for observer in self._observers:
            observer.on_truth_used(packet.shot, age_ns, accepted)
        since_ns = max(self.newest_arrived_ns - self._start_ns, packet.due_ns)
        self._unreported_shots.append((packet.shot, since_ns))

    def _age_ns(self, time_ns: int) -> int:
        newest = self.newest
        return 0 if newest is None else max(0, time_ns - newest.time_ns)

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:
        while self._unreported_shots and self._unreported_shots[0][0] <= packet.shot:
            shot, since_ns = self._unreported_shots.popleft()
            if shot == packet.shot and report.status is DeliveryStatus.SENT:
                self._response.add(max(0, report.sent_ns - since_ns))

    def to_json(self) -> dict[str, Any]:
        """The counts, by the keys of the summary file."""
        verdicts = self._trajectory.verdicts
        return {
            "datagrams": {verdict.name.lower(): verdicts[verdict] for verdict in Verdict},
            "lost": self._trajectory.lost,
            "jumped": self._trajectory.jumped,
            "resumed": self._trajectory.resumed,
            "ignored": self._senders.ignored,
            "ended_by": self._ended_by,
            "stale_shots": self._stale,
            "undelivered_answers": self._undelivered,
            "age": self._age.summary(),
            "response": self._response.summary(),
            **events_to_json("truth", self._events.count, self._events.since(0)),
        }

    def _happened(self, arrived_ns: int, what: str) -> None:
        # Scenario time by the clock, or in lockstep and before the start by the newest truth.
        if self._start_ns is not None:
            time_ns = max(0, arrived_ns - self._start_ns)
        else:
            time_ns = 0 if self.newest is None else self.newest.time_ns
        self._events.add(self._events.count + 1, time_ns, what)
        self._new_events.append((time_ns, what))

    def _check(self, data: bytes, arrived_ns: int, sender: Any) -> ReceivedTruth:
        truth = Truth.from_bytes(data)
        before, resumed = self.newest, self._trajectory.resumed
        verdict = self._trajectory.accept(
            truth, None if self._start_ns is None else arrived_ns - self._start_ns
        )
        if verdict is Verdict.ACCEPTED:
            self.newest_arrived_ns = arrived_ns
            self._senders.accepted(sender)
        if self._trajectory.resumed > resumed and truth is not None and before is not None:
            away_s = (truth.time_ns - before.time_ns) * 1e-9
            self._happened(arrived_ns, f"refused truth is believed, {away_s:+.3f} s from the newest before")
        # The last truth may be a duplicate that only sets the flag.
        is_believed = verdict in (Verdict.ACCEPTED, Verdict.DUPLICATE)
        if truth is not None and truth.last and is_believed and not self.ended:
            self.ended, self._ended_by = True, sender_name(sender)
            self._happened(arrived_ns, f"{self._ended_by} ended the flight")
        if self._begun or len(self._unreported) < _EARLY_DATAGRAMS:
            newest = self.newest
            lockstep_ns = 0 if newest is None else newest.time_ns
            self._unreported.append((data, arrived_ns, lockstep_ns, verdict is Verdict.ACCEPTED))
        return ReceivedTruth(truth, verdict, sequence_of(data), arrived_ns, sender)

"""Truth from a simulator as a run uses it: received, judged, shown to observers, counted."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from lidar_emu.errors import InputError, reason_of
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.feed.datagram_socket import DatagramSocket
from lidar_emu.runtime.lateness import LatenessHistogram
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import DeliveryStatus, Outgoing, Report
from lidar_emu.trajectory.live_datagram import Answer, Truth, Verdict, sequence_of

if TYPE_CHECKING:
    from lidar_emu.trajectory.live import LiveTrajectory

_UNTOLD = 1000
"""Datagrams before the run that observers hear of once it has begun."""


def truth_socket(address: str, clock: Clock) -> DatagramSocket:
    """The socket on which a simulator's truth arrives.

    Raises:
        InputError: it cannot be bound.
    """
    try:
        return DatagramSocket(address, clock)
    except (OSError, ValueError) as error:
        allowed = f"{reason_of(error)}; allowed: udp:HOST:PORT or unix:PATH"
        raise InputError("trajectory", "listen", address, allowed) from None


class Arrival(NamedTuple):
    """A datagram that came in."""

    truth: Truth | None
    """None if it was none."""
    verdict: Verdict
    sequence: int
    """Its number, as far as it has one."""
    arrived_ns: int
    """Instant of the monotonic clock."""
    sender: Any
    """The address that it came from."""


class TruthSource(Observer):
    """Feeds a live trajectory from a socket, and looks how soon what comes of it is sent.

    Args:
        stale_after_ns: age above which truth is stale.
    """

    def __init__(
        self,
        socket: DatagramSocket,
        trajectory: LiveTrajectory,
        stale_after_ns: int,
        observers: Sequence[Observer],
    ) -> None:
        self._socket = socket
        self._trajectory = trajectory
        self._stale_after_ns = stale_after_ns
        self._observers = observers
        self._age = LatenessHistogram()
        self._stale = 0
        self._undelivered = 0
        self._response = LatenessHistogram()
        self._awaited: deque[tuple[int, int]] = deque()
        self.ended = False
        """Whether a truth has said that the flight ends with it."""
        self._start_ns: int | None = None
        self._begun = False
        self._untold: list[tuple[bytes, int, int, bool]] = []
        self.newest_arrived_ns = 0
        """Instant of the monotonic clock."""

    def fileno(self) -> int:
        """Ready when something arrived."""
        return self._socket.fileno()

    def receive(self) -> list[Arrival]:
        """Take what arrived into account."""
        return [self._judged(*arrived) for arrived in self._socket.receive()]

    def receive_one(self) -> None:
        """The same for the first datagram only: asking in vain for another one would take the time of a shot's tenth
        part."""
        for arrived in self._socket.receive(1):
            self._judged(*arrived)

    def rehearse(self) -> None:
        """Go through the newest truth once more, without any consequence."""
        newest = None if self.newest is None else Truth.from_bytes(self.newest.to_bytes())
        if newest is not None:
            self._trajectory.rehearse(newest)

    def expect(self, start_ns: int) -> None:
        """Scenario time 0 is at this instant of the monotonic clock, as is known before the first truth."""
        self._start_ns = start_ns

    def begin(self, start_ns: int | None) -> None:
        """The run begins.

        Args:
            start_ns: instant of the monotonic clock at scenario time 0; None in lockstep.
        """
        self._start_ns, self._begun = start_ns, True

    def tell(self) -> None:
        """Let observers hear of what has come since the last time. The run has begun; no shot waits for it."""
        untold, self._untold = self._untold, []
        for data, arrived_ns, lockstep_ns, counted in untold:
            time_ns = lockstep_ns if self._start_ns is None else arrived_ns - self._start_ns
            for observer in self._observers:
                observer.on_truth(data, max(0, time_ns), counted)

    def answer(self, parts: Sequence[Answer], receiver: Any) -> None:
        """To the sender of a datagram; an answer that cannot be delivered is counted."""
        for part in parts:
            self._undelivered += not self._socket.answer(part.to_bytes(), receiver)

    @property
    def newest(self) -> Truth | None:
        """The truth that counts; None before the first."""
        return self._trajectory.newest

    def covers(self, time_ns: int) -> bool:
        """Whether truth reaches up to a scenario time."""
        newest = self.newest
        return newest is not None and newest.time_ns >= time_ns

    def is_fresh_at(self, time_ns: int) -> bool:
        """Whether truth is not stale for a shot valid at this scenario time."""
        return self._age_ns(time_ns) <= self._stale_after_ns

    def used_for(self, packet: Outgoing, time_ns: int) -> None:
        """Note that a packet, of a shot valid at this scenario time, was made from the newest truth."""
        age_ns = self._age_ns(time_ns)
        self._age.add(age_ns)
        self._stale += age_ns > self._stale_after_ns
        assert self._start_ns is not None
        assert self.newest is not None
        for observer in self._observers:
            observer.on_truth_used(packet.shot, age_ns, self.newest.time_ns)
        since_ns = max(self.newest_arrived_ns - self._start_ns, packet.due_ns)
        self._awaited.append((packet.shot, since_ns))

    def _age_ns(self, time_ns: int) -> int:
        newest = self.newest
        return 0 if newest is None else max(0, time_ns - newest.time_ns)

    def on_report(self, packet: Outgoing, report: Report) -> None:
        """Count how long it took from truth in, or from when the packet was due if that was later, to its last byte
        written."""
        while self._awaited and self._awaited[0][0] <= packet.shot:
            shot, since_ns = self._awaited.popleft()
            if shot == packet.shot and report.status is DeliveryStatus.SENT:
                self._response.add(max(0, report.sent_ns - since_ns))

    def to_json(self) -> dict[str, Any]:
        """The counts under the names of the summary file."""
        verdicts = self._trajectory.verdicts
        return {
            "datagrams": {verdict.name.lower(): verdicts[verdict] for verdict in Verdict},
            "lost": self._trajectory.lost,
            "jumped": self._trajectory.jumped,
            "stale_shots": self._stale,
            "undelivered_answers": self._undelivered,
            "age": self._age.summary(),
            "response": self._response.summary(),
        }

    def _judged(self, data: bytes, arrived_ns: int, sender: Any) -> Arrival:
        truth = Truth.from_bytes(data)
        verdict = self._trajectory.accept(
            truth, None if self._start_ns is None else arrived_ns - self._start_ns
        )
        if verdict is Verdict.ACCEPTED:
            self.newest_arrived_ns = arrived_ns
        # The last truth may say again what the one before it said.
        if truth is not None and verdict in (Verdict.ACCEPTED, Verdict.DUPLICATE):
            self.ended |= truth.last
        if self._begun or len(self._untold) < _UNTOLD:
            newest = self.newest
            lockstep_ns = 0 if newest is None else newest.time_ns
            self._untold.append((data, arrived_ns, lockstep_ns, verdict is Verdict.ACCEPTED))
        return Arrival(truth, verdict, sequence_of(data), arrived_ns, sender)

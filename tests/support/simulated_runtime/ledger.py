"""The ledger of a run: what was computed, sent, reported and acknowledged, and the invariants between them."""

from __future__ import annotations

from collections import Counter, deque
from datetime import datetime
from typing import TYPE_CHECKING, Any

from lidar_emu.runtime.change_queue import ReceivedCommand
from lidar_emu.runtime.observer import EventSource, Observer
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace, payload_of
from lidar_emu.session import Block
from simulated_runtime.scheduler import Failure

if TYPE_CHECKING:
    from lidar_emu.runtime.summary import Tally

_WITHOUT_BYTES = (DeliveryStatus.SUPPRESSED, DeliveryStatus.HELD, DeliveryStatus.LATE)
_DROPPED = {
    "full": DeliveryStatus.DROPPED_FULL,
    "nobody_connected": DeliveryStatus.DROPPED_NOBODY,
    "broken": DeliveryStatus.DROPPED_BROKEN,
}


def require(holds: bool, what: str, *values: Any) -> None:
    """Fail unless an invariant holds."""
    if not holds:
        raise Failure(" ".join((what, *(repr(value)[:200] for value in values))))


class Ledger(Observer):
    """Observes a run, and checks each report as it arrives.

    Args:
        pace, late_after_ns: when packets are sent.
        tally: what the run counts.
    """

    def __init__(self, pace: Pace, late_after_ns: int, tally: Tally) -> None:
        self._pace, self._late_after_ns, self._tally = pace, late_after_ns, tally
        self._generation = 0
        self._computed: dict[tuple[int, int], tuple[bytes, bool]] = {}
        self._marks: list[tuple[int, int]] = []
        self.last = -1
        self.statuses: Counter[DeliveryStatus] = Counter()
        self.silent = 0
        self.sent: list[bytes] = []
        """Payloads of shots that were reported as sent."""
        self.shots: list[tuple[int, bool, bool, bytes]] = []
        """Each shot: its number in the scenario, whether it was silent, whether it was sent, its packet."""
        self.waited_ns: int | None = None
        self.faults: list[Any] = []
        self.reports: list[tuple[int, int, bytes]] = []
        self.times: list[tuple[int, int, int, int]] = []
        """Shot, status, and when the port process woke and had sent each packet."""
        self.is_open = False
        self.missed: set[int] = set()
        """Shots that were too late to be computed."""
        self.made: deque[bytes] = deque()
        """Acknowledgements and housekeeping without a result."""
        self.between: list[bytes] = []
        """Acknowledgements and housekeeping that were reported as sent."""
        self.between_dropped = 0
        self.acknowledged: list[tuple[int, bytes]] = []
        """Scenario time and packet of each acknowledgement."""
        self.housekeeping: list[tuple[int, bytes, int]] = []
        """Scenario time, packet, and how many commands the shots follow already."""
        self.verdicts: Counter[str] = Counter()
        self.commands: list[tuple[ReceivedCommand, int | None]] = []
        self.events: list[tuple[str, int, str]] = []
        self.blocks: list[int] = []

    def on_opened(self, port: str, start: datetime) -> None:  # noqa: ARG002
        self.is_open = True

    def on_block_computed(self, block: Block) -> None:
        shots = block.measurement.shot.tolist()
        for shot, packet in zip(shots, block.packets, strict=True):
            key = self._generation, shot
            require(key not in self._computed, "computed twice in a generation:", key)
            self._computed[key] = payload_of(packet), block.silent

    def on_superseded(self, generation: int, from_shot: int) -> None:
        require(generation == self._generation + 1, "generations count by one:", generation)
        self._generation = generation
        self._marks.append((generation, from_shot))

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:
        require(packet.shot == report.shot, "a report of another shot:", packet.shot, report)
        status = report.status
        computed = self._computed.get((packet.generation, packet.shot))
        if self.last < 0:
            self.last = packet.shot - 1
        require(packet.shot == self.last + 1, "each shot once, in order:", self.last, report)
        self.last = packet.shot
        if computed is None:
            self.missed.add(packet.shot)
        self.statuses[status] += 1
        silent = False
        if computed is not None:
            payload, silent = computed
            require(payload == packet.payload, "a packet that was not computed for its shot:", packet.shot)
        else:
            require(status is DeliveryStatus.LATE, "a shot that was never computed:", report)
        require(bool(packet.payload) or status in _WITHOUT_BYTES, "sent without bytes:", report)
        empty = computed is not None and not packet.payload
        require(not empty or status is not DeliveryStatus.LATE, "late, but there is nothing to send:", report)
        require(
            not packet.payload or status not in (DeliveryStatus.SUPPRESSED, DeliveryStatus.HELD),
            "lost:",
            report,
        )
        if status is DeliveryStatus.SENT:
            self.sent.append(packet.payload)
        self._check_times(packet, report)
        self.silent += silent and status is DeliveryStatus.SUPPRESSED
        self.shots.append((packet.shot, silent, status is DeliveryStatus.SENT, packet.payload))
        self.times.append((packet.shot, int(status), report.woke_ns, report.sent_ns))
        self.reports.append((packet.shot, int(status), packet.payload))

    def _check_times(self, packet: OutgoingPacket, report: DeliveryReport) -> None:
        status = report.status
        if self._pace is not Pace.WALL:
            require(status is not DeliveryStatus.LATE, "late without a clock:", report)
            return
        if status is DeliveryStatus.SENT:
            require(report.sent_ns >= packet.due_ns, "sent before it was due:", report)
            require(report.woke_ns <= packet.due_ns + self._late_after_ns, "sent too late:", report)
        if status is DeliveryStatus.LATE:
            require(report.woke_ns > packet.due_ns + self._late_after_ns, "not late at all:", report)

    def on_acknowledgement(self, payload: bytes, time_ns: int) -> None:
        self.acknowledged.append((time_ns, payload))
        self.made.append(payload)

    def on_housekeeping(self, payload: bytes, time_ns: int) -> None:
        last_ns = self.housekeeping[-1][0] if self.housekeeping else None
        # A poll brings what a command in the same breath has made due.
        ascends = last_ns is None or time_ns > last_ns or (self._tally.polled and time_ns == last_ns)
        require(ascends, "housekeeping goes back:", time_ns)
        accepted = sum(command.verdict == "accepted" for command, _ in self.commands)
        self.housekeeping.append((time_ns, payload, accepted))
        self.made.append(payload)

    def on_sent_between(self, time_ns: int | None) -> None:
        require(bool(self.made), "a result of nothing")
        payload = self.made.popleft()
        if time_ns is None:
            self.between_dropped += 1
        else:
            self.between.append(payload)

    def on_flight_started(self, waited_ns: int) -> None:
        self.waited_ns = waited_ns
        self.housekeeping.clear()
        self.commands = [
            (command._replace(time_ns=command.time_ns - waited_ns), 0) for command, _ in self.commands
        ]
        self.acknowledged = [(time_ns - waited_ns, payload) for time_ns, payload in self.acknowledged]

    def on_fault_injected(self, number: int, fault: Any, shot: int) -> None:  # noqa: ARG002
        self.faults.append(fault)

    def on_command(self, command: ReceivedCommand, shot: int | None) -> None:
        self.verdicts[command.verdict] += 1
        self.commands.append((command, shot))

    def on_block_sent(self, block: Block) -> None:
        self.blocks += block.measurement.shot.tolist()

    def on_event(self, source: EventSource, time_ns: int, what: str) -> None:
        self.events.append((source, time_ns, what))

    def check_step(self) -> None:
        """What must hold at any time."""
        tally, counts = self._tally, self.statuses
        require(tally.due == counts.total(), "the tally counts each report:", tally.due, counts)
        require(
            tally.sent == counts[DeliveryStatus.SENT] == len(self.sent),
            "the tally counts what was sent:",
            counts,
        )

    def check_summary(self, shots: dict[str, Any]) -> None:
        """The summary counts what was reported."""
        counts = self.statuses
        dropped = {name: counts[status] for name, status in _DROPPED.items()}
        counted = {
            "due": counts.total(),
            "sent": counts[DeliveryStatus.SENT],
            "late": counts[DeliveryStatus.LATE],
            "suppressed": self.silent,
            "not_polled": counts[DeliveryStatus.NOT_POLLED],
            "dropped": dropped,
        }
        require(shots == counted, "the summary and the reports differ:", shots, counted)


def match_wire(taken: list[bytes], shots: list[bytes], between: list[bytes], lossless: bool) -> list[bytes]:
    """Check that what the line took are the payloads that were reported as sent, each once, in order; return the rest.

    Args:
        taken: payloads that the line took.
        shots, between: payloads reported as sent.
        lossless: False: payloads may have been lost in a buffer of the device.
    """
    shot_queue, between_queue, rest = deque(shots), deque(between), list[bytes]()
    for payload in taken:
        for queue in () if lossless else (shot_queue, between_queue):
            while queue and queue[0] != payload and payload in queue:
                queue.popleft()
        if shot_queue and shot_queue[0] == payload:
            shot_queue.popleft()
        elif between_queue and between_queue[0] == payload:
            between_queue.popleft()
        else:
            rest.append(payload)
    require(not lossless or not (shot_queue or between_queue), "reported, but never on the line:",
            len(shot_queue), len(between_queue), list(shot_queue)[:1])  # fmt: skip
    return rest

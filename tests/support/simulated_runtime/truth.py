"""A simulated simulator: it sends live truth, late, twice, never or damaged, and in lockstep waits for answers."""

from __future__ import annotations

from typing import Any

from lidar_emu.trajectory.live_datagram import Answer, AnsweredPacket, Truth, Verdict
from simulated_runtime.ledger import require
from simulated_runtime.machine import SimulatedMachine, SimulatedSocket
from simulated_runtime.scheduler import Scheduler

ADDRESS = "udp:127.0.0.1:5600"
_ME, _STRANGER = ("127.0.0.1", 40_001), ("127.0.0.1", 40_002)
_STILL = (0.0, 0.0, 0.0)
_FACING_DOWN = (0.0, 0.5**0.5, 0.5**0.5, 0.0)
_SINK_MPS = 20.0
_REPEATS_NS = 150_000_000


class SimulatedSimulator:
    """A descent at constant speed, told every `step_ns`.

    Args:
        latency_ns: longest time that a datagram takes.
        ends_ns: scenario time of the last truth.
    """

    def __init__(
        self, scheduler: Scheduler, machine: SimulatedMachine, step_ns: int, latency_ns: int, ends_ns: int
    ) -> None:
        self._scheduler, self._machine = scheduler, machine
        self._step_ns, self._latency_ns, self._ends_ns = step_ns, latency_ns, ends_ns
        self._begun_ns = 0
        self._count = 0
        self._held: list[bytes] | None = None
        self._lossy_until_ns = self._held_until_ns = 0
        self.answered: list[AnsweredPacket] = []
        self._parts: list[Answer] = []
        self._awaits: int | None = None
        self._is_over = False

    def truth(self, number: int) -> Truth:
        time_ns = number * self._step_ns
        height_m = 2000.0 - _SINK_MPS * time_ns * 1e-9
        velocity = (0.0, 0.0, -_SINK_MPS)
        last = time_ns >= self._ends_ns
        return Truth(number, time_ns, (0.0, 0.0, height_m), velocity, _STILL, _FACING_DOWN, _STILL, last)

    # In real time

    def fly(self) -> None:
        """Begin to send truth at its times."""
        self._begun_ns = self._scheduler.now_ns
        self._tick()

    def lose(self, duration_ns: int) -> None:
        """Send nothing for a while."""
        self._lossy_until_ns = self._scheduler.now_ns + duration_ns

    def hold(self, duration_ns: int) -> None:
        """Hold datagrams back for a while, then deliver them all."""
        self._held_until_ns = self._scheduler.now_ns + duration_ns

    def repeat(self) -> None:
        """Send the last truth once more."""
        self._deliver(self.truth(max(0, self._count - 1)).to_bytes())

    def damage(self, data: bytes) -> None:
        """Send something else."""
        self._deliver(data)

    def intrude(self) -> None:
        """Another simulator sends a truth that ends the flight."""
        self._deliver(self.truth(10**6).to_bytes(), _STRANGER)

    def _tick(self) -> None:
        truth, now_ns = self.truth(self._count), self._scheduler.now_ns
        self._count += 1
        if now_ns >= self._lossy_until_ns:
            late_ns = int(self._scheduler.random.random() * self._latency_ns)
            at_ns = max(now_ns + late_ns, self._held_until_ns)
            self._scheduler.at(at_ns, lambda: self._deliver(truth.to_bytes()))
        if not truth.last:
            self._scheduler.at(self._begun_ns + self._count * self._step_ns, self._tick)
        else:
            # A last truth may be lost: it is repeated for some time.
            for k in range(1, 20):
                self._scheduler.at(now_ns + 250_000_000 * k, lambda: self._deliver(truth.to_bytes()))

    def _deliver(self, data: bytes, sender: Any = _ME) -> None:
        socket = self._socket()
        if socket is not None:
            socket.deliver(data, sender)

    def _socket(self) -> SimulatedSocket | None:
        return self._machine.sockets.get(ADDRESS)

    # In lockstep

    def step_along(self) -> None:
        """Send truth after truth, each once the one before is answered; repeat one whose answer does not come."""
        socket = self._socket()
        if socket is None:
            if not self._is_over and self._count == 0:
                self._scheduler.at(self._scheduler.now_ns + _REPEATS_NS, self.step_along)
            return
        socket.on_answer = self._take
        self._send_step(self._count)

    def _send_step(self, number: int) -> None:
        if self._awaits is not None and self._awaits != number:
            return
        if self._count > number or self._socket() is None:
            return
        self._awaits = number
        if self._scheduler.now_ns >= self._lossy_until_ns:
            self._deliver(self.truth(number).to_bytes())
        self._scheduler.at(self._scheduler.now_ns + _REPEATS_NS, lambda: self._send_step(number))

    def _take(self, datagram: bytes) -> bool:
        answer = Answer.from_bytes(datagram)
        if answer.sequence != self._awaits or answer.verdict is not Verdict.ACCEPTED:
            return True
        if self._scheduler.now_ns < self._lossy_until_ns:
            return True  # the answer is lost on its way
        self._parts.append(answer)
        if answer.more:
            return True
        require([part.more for part in self._parts] == [*range(len(self._parts))][::-1], "parts of an answer")
        self.answered += [packet for part in self._parts for packet in part.packets]
        self._parts.clear()
        last = self.truth(answer.sequence).last
        self._awaits, self._count = None, answer.sequence + 1
        if not last:
            number = self._count
            delay_ns = int(self._scheduler.random.random() * self._latency_ns)
            self._scheduler.at(self._scheduler.now_ns + delay_ns, lambda: self._send_step(number))
        return True

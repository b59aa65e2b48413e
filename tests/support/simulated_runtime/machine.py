"""The machine of a simulated run: its port process, pipes and datagram sockets."""

from __future__ import annotations

import fcntl
import os
import select
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from io import FileIO
from typing import IO, Any

from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.port.process import own_port
from lidar_emu.runtime.realtime_priority import RealtimePrivileges
from lidar_emu.transports.link import PortChannel
from lidar_emu.transports.sockets import DatagramSocket
from simulated_runtime.scheduler import SIMULATED_DESCRIPTORS, Process, Scheduler, SimulatedClock

_WRITTEN_AT_ONCE = select.PIPE_BUF
_STANDARD_ERROR = 2


class _ControlPipe(FileIO):
    """The writing end: a process that writes to a full pipe waits in simulated time."""

    def __init__(self, descriptor: int, scheduler: Scheduler) -> None:
        super().__init__(descriptor, "w")
        self._scheduler = scheduler

    def write(self, data: Any) -> int | None:
        if self._scheduler.model.killed or self._scheduler.failure is not None:
            return None
        if not os.get_blocking(self.fileno()):
            return super().write(data)
        for first in range(0, len(data), _WRITTEN_AT_ONCE):
            self._scheduler.wait(None, [], [self.fileno()])
            super().write(data[first : first + _WRITTEN_AT_ONCE])
        return len(data)


class _PortProcess:
    """The port process as a process of the scheduler."""

    pid = 4711

    def __init__(
        self,
        scheduler: Scheduler,
        clock: SimulatedClock,
        inherited: tuple[int, ...],
        opener_of: Callable[..., Any],
        pipe_bytes: int,
    ) -> None:
        self._scheduler = scheduler
        control, control_in = os.pipe()
        status_out, status = os.pipe()
        fcntl.fcntl(status, fcntl.F_SETPIPE_SZ, pipe_bytes)
        self.stdin = _ControlPipe(control_in, scheduler)
        self.stdout = FileIO(status_out, "r")

        def run() -> None:
            try:
                scheduler.check()
                own_port(control, status, clock, opener_of, lambda: RealtimePrivileges(["simulated"], {}))
            finally:
                for descriptor in (control, status, *inherited):
                    os.close(descriptor)

        self.process: Process = scheduler.start("port", run, control)

    def wait(self) -> int:
        while not (self.process.ended or self._scheduler.model.killed):
            self._scheduler.spend(1_000_000)
        return -9 if self.process.killed else 0

    def kill(self) -> None:
        # A model process that was killed kills nobody.
        if not self._scheduler.model.killed:
            self._scheduler.kill(self.process)


class SimulatedSocket(DatagramSocket):
    """A datagram socket whose other end is in the world outside."""

    def __init__(self, machine: SimulatedMachine, address: str) -> None:
        self._machine, self.address = machine, address
        self._arrived: deque[tuple[bytes, Any]] = deque()
        self._descriptor = machine.descriptor_of(self)
        self.on_answer: Callable[[bytes], bool] = lambda _: True

    def is_readable(self) -> bool:
        return bool(self._arrived)

    def is_writable(self) -> bool:
        return True

    def deliver(self, datagram: bytes, sender: Any) -> None:
        self._arrived.append((datagram, sender))

    def fileno(self) -> int:
        return self._descriptor

    def receive(self, most: int = 64) -> list[tuple[bytes, int, Any]]:
        arrived = []
        while self._arrived and len(arrived) < most:
            data, sender = self._arrived.popleft()
            arrived.append((data, self._machine.clock.now_ns(), sender))
        return arrived

    def answer(self, datagram: bytes, receiver: Any) -> bool:  # noqa: ARG002
        return self.on_answer(datagram)

    def close(self) -> None:
        self._machine.sockets.pop(self.address, None)


class SimulatedMachine(Machine):
    """A machine in simulated time.

    Args:
        open_port: opens the port.
        errors: standard error of the port process.
        share: see `Machine.busy_wait_share`.
        pipe_bytes: room of the pipe in which the port process reports.
    """

    clock: SimulatedClock

    def __init__(
        self,
        scheduler: Scheduler,
        open_port: Callable[[], PortChannel],
        errors: IO[bytes],
        share: float,
        pipe_bytes: int,
    ) -> None:
        self.clock = SimulatedClock(scheduler)
        self._scheduler, self._open, self._share = scheduler, open_port, share
        self.sockets: dict[str, SimulatedSocket] = {}
        self.ports: list[_PortProcess] = []
        self._errors, self._pipe_bytes = errors, pipe_bytes

    def descriptor_of(self, device: Any) -> int:
        number = SIMULATED_DESCRIPTORS + len(self._scheduler.devices)
        self._scheduler.devices[number] = device
        return number

    def start_port(self, descriptors: tuple[int, ...], errors: int) -> Any:  # noqa: ARG002
        for descriptor in descriptors:
            if os.path.sameopenfile(descriptor, _STANDARD_ERROR):
                os.dup2(self._errors.fileno(), descriptor)

        process = _PortProcess(
            self._scheduler, self.clock, descriptors, lambda *_: self._open, self._pipe_bytes
        )
        self.ports.append(process)
        return self.ports[-1]

    def datagram_socket(self, address: str) -> DatagramSocket:
        self.sockets[address] = SimulatedSocket(self, address)
        return self.sockets[address]

    def busy_wait_share(self) -> float:
        return self._share

    def realtime_priority(self) -> AbstractContextManager[None]:
        return nullcontext()

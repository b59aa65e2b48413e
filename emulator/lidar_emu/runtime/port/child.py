"""The port process as a child of the model process: its start, its pipes and its end."""

from __future__ import annotations

import fcntl
import json
import os
import select
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from lidar_emu.errors import RunError, one_line
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.port.exchange import anonymous_file

_READ_BYTES = 65536
_FIRST_NOT_STANDARD = 3
_STANDARD_ERROR = 2


class PortDiedError(RunError):
    """The port process has died."""


class PortChild:
    """`lidar_emu.runtime.port.process` in its own session, which no terminal's Ctrl-C reaches.

    Args:
        descriptors: descriptors that the child inherits besides the three standard ones, by name; the
            caller still owns them.
        machine: starts it.
    """

    def __init__(self, descriptors: Mapping[str, int], machine: Machine) -> None:
        self.ended = False
        """Whether its status pipe has ended."""
        self._received = b""
        self._errors = anonymous_file()
        # If this process was started without standard descriptors, ours may have taken their numbers.
        copies = {
            name: fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _FIRST_NOT_STANDARD)
            for name, descriptor in descriptors.items()
        }
        self.inherited = copies
        """The numbers of `descriptors` in the child."""
        self._process = machine.start_port(tuple(copies.values()), self._errors)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._control = self._process.stdin
        self._status = self._process.stdout

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def descriptor(self) -> int:
        """Ready when there is something to `receive`."""
        return self._status.fileno()

    def send(self, **message: object) -> None:
        """Send a message. A dead child is reported by `ended`, for the caller may be in the middle of something."""
        with suppress(BrokenPipeError):
            self._control.write(json.dumps(message).encode() + b"\n")

    def receive(self) -> list[dict[str, Any]]:
        """The messages since the last call; sets `ended` at the end of file."""
        messages: list[dict[str, Any]] = []
        while not self.ended and select.select([self._status], [], [], 0)[0]:
            data = os.read(self.descriptor, _READ_BYTES)
            self.ended = not data
            *lines, self._received = (self._received + data).split(b"\n")
            messages += (json.loads(line) for line in lines)
        return messages

    def death(self) -> PortDiedError:
        """Why it ended, with the last line of its standard error."""
        status = self._process.wait()
        how = f"signal {-status}" if status < 0 else f"exit code {status}"
        errors = os.pread(self._errors, _READ_BYTES, 0).decode(errors="replace")
        what = [f"the port process ended ({how})", *errors.splitlines()[-1:]]
        return PortDiedError(one_line(": ".join(what)))

    def close_control(self, orderly: bool) -> None:
        """Close the control pipe: the child closes the port and ends.

        Args:
            orderly: False: the child sends the final message first.
        """
        os.set_blocking(self._control.fileno(), False)  # a hanging child may have left the pipe full
        self.send(end=orderly)
        self._control.close()

    def kill(self) -> None:
        """Kill the process if it still runs, and release all resources."""
        self._process.kill()
        self._process.wait()
        self._control.close()
        self._status.close()
        os.close(self._errors)


def standard_error() -> dict[str, int]:
    """Standard error, if there is one: the port process reports there if it survives the model process."""
    try:
        os.fstat(_STANDARD_ERROR)
    except OSError:
        return {}
    return {"stderr": _STANDARD_ERROR}


STALL_NS = 100_000_000
"""Shortest stall that is reported."""

OnStall = Callable[[int, str], None]
"""Receives the time, in nanoseconds from the start of the run, and a description of the event."""


class StallMonitor:
    """Runs in the model process, which polls it several times in `STALL_NS` unless it computes.

    The port process reports every packet as soon as it is due, sent or not. The model process computes or sleeps for
    short times only: time between two polls in which it had no processor time is a stall of the model process.

    Args:
        on_stall: called when the port process stalls, when it resumes, and after a stall of the model process.
    """

    def __init__(self, clock: Clock, on_stall: OnStall | None) -> None:
        self._clock = clock
        self._on_stall = on_stall or (lambda *_: None)
        self._unreported_due_ns: deque[int] = deque()
        self._reported = 0
        self._start_ns: int | None = None
        self._poll_ns = 0
        self._polled_ns = self._processor_time_ns = 0
        self._overdue_after = -1
        self._overdue_since_ns = 0
        self._silent_since_ns: int | None = None

    def begin(self, start_ns: int, poll_ns: int = 0) -> None:
        """Start monitoring a run that keeps pace with the wall clock.

        Args:
            start_ns: start of the run, an instant of the monotonic clock.
            poll_ns: how long the port process may keep a packet that is due.
        """
        self._start_ns, self._poll_ns = start_ns, poll_ns
        self._polled_ns = self._clock.now_ns() - start_ns
        self._processor_time_ns = self._clock.processor_time_ns()

    def pushed(self, due_ns: int) -> None:
        """Count a packet that was pushed to the port process."""
        self._unreported_due_ns.append(due_ns)

    def reported(self, count: int) -> None:
        """Count packets that the port process has reported."""
        self._reported += count
        for _ in range(count):
            self._unreported_due_ns.popleft()

    def poll(self) -> None:
        """Check both processes; call after all available reports were counted."""
        if self._start_ns is None:
            return
        now_ns = self._clock.now_ns() - self._start_ns
        self._check_port(now_ns)
        self._check_model(now_ns)

    def _check_port(self, now_ns: int) -> None:
        due_ns = self._unreported_due_ns[0] + self._poll_ns if self._unreported_due_ns else now_ns
        if due_ns >= now_ns or self._overdue_after != self._reported:
            # A packet that is overdue for the first time counts from now: it may have been pushed just now.
            self._overdue_after, self._overdue_since_ns = self._reported if due_ns < now_ns else -1, now_ns
            if self._silent_since_ns is not None:
                silent_ms = (now_ns - self._silent_since_ns) / 1e6
                self._silent_since_ns = None
                self._on_stall(now_ns, f"the port process responds again, after {silent_ms:.0f} ms")
        elif self._silent_since_ns is None and now_ns - self._overdue_since_ns > STALL_NS:
            self._silent_since_ns = self._overdue_since_ns
            self._on_stall(now_ns, "the port process does not respond")

    def _check_model(self, now_ns: int) -> None:
        processor_time_ns = self._clock.processor_time_ns()
        stalled_ns = now_ns - self._polled_ns - (processor_time_ns - self._processor_time_ns)
        self._polled_ns, self._processor_time_ns = now_ns, processor_time_ns
        if stalled_ns > STALL_NS:
            self._on_stall(now_ns, f"the model process stalled for {stalled_ns / 1e6:.0f} ms")

"""The port process as a child of the model process: its start, its pipes and its end."""

from __future__ import annotations

import fcntl
import json
import os
import select
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from lidar_emu.errors import RunError, one_line
from lidar_emu.runtime.port.shared_ring import anonymous_file

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
    """

    def __init__(self, descriptors: Mapping[str, int]) -> None:
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
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "lidar_emu.runtime.port.process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                pass_fds=tuple(copies.values()),
                start_new_session=True,
                bufsize=0,
            )
        finally:
            for copy in copies.values():
                os.close(copy)
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
        return PortDiedError(
            one_line(": ".join([f"the port process ended ({how})", *errors.splitlines()[-1:]]))
        )

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

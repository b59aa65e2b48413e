"""The port process as its parent sees it: started, told, heard, ended."""

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
from lidar_emu.runtime.port.ring import anonymous_file

_READ_BYTES = 65536
_FIRST_NOT_STANDARD = 3
_STANDARD_ERROR = 2


class PortDiedError(RunError):
    """The process that owned the port is no more."""


class PortChild:
    """`lidar_emu.runtime.port.process` in a session of its own, where no terminal's Ctrl-C reaches it.

    Args:
        descriptors: what it inherits besides its three standard ones, by name; they stay the caller's.
    """

    def __init__(self, descriptors: Mapping[str, int]) -> None:
        self.ended = False
        """Whether it has said its last."""
        self._heard = b""
        self._errors = anonymous_file()
        # In a process that was started without standard descriptors ours may have taken their numbers.
        copies = {
            name: fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _FIRST_NOT_STANDARD)
            for name, descriptor in descriptors.items()
        }
        self.inherited = copies
        """The numbers under which it knows `descriptors`."""
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
        self._lifeline = self._process.stdin
        self._answers = self._process.stdout

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    @property
    def descriptor(self) -> int:
        """Ready when there is something to hear."""
        return self._answers.fileno()

    def tell(self, **order: object) -> None:
        """Give it a line. Of its death one hears (`ended`): who tells may be in the middle of something else."""
        with suppress(BrokenPipeError):
            self._lifeline.write(json.dumps(order).encode() + b"\n")

    def hear(self) -> list[dict[str, Any]]:
        """What it has said since the last call; sets `ended` at the end."""
        answers: list[dict[str, Any]] = []
        while not self.ended and select.select([self._answers], [], [], 0)[0]:
            data = os.read(self.descriptor, _READ_BYTES)
            self.ended = not data
            *lines, self._heard = (self._heard + data).split(b"\n")
            answers += (json.loads(line) for line in lines)
        return answers

    def death(self) -> PortDiedError:
        """How it came to its end, with the last line that it wrote about it."""
        status = self._process.wait()
        how = f"signal {-status}" if status < 0 else f"exit code {status}"
        errors = os.pread(self._errors, _READ_BYTES, 0).decode(errors="replace")
        return PortDiedError(
            one_line(": ".join([f"the port process ended ({how})", *errors.splitlines()[-1:]]))
        )

    def hang_up(self, in_order: bool) -> None:
        """Cut the lifeline: it closes the port and ends.

        Args:
            in_order: False: first it says its final message.
        """
        os.set_blocking(self._lifeline.fileno(), False)  # it may hang, with a full pipe
        self.tell(end=in_order)
        self._lifeline.close()

    def kill(self) -> None:
        """Make sure that it has ended, and give everything back."""
        self._process.kill()
        self._process.wait()
        self._lifeline.close()
        self._answers.close()
        os.close(self._errors)


def complaints() -> dict[str, int]:
    """Standard error, where there is one: a process that survives ours can say so there."""
    try:
        os.fstat(_STANDARD_ERROR)
    except OSError:
        return {}
    return {"complaints": _STANDARD_ERROR}

"""What a run takes from the machine that it runs on. A simulation puts another one in its place."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import AbstractContextManager

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.realtime_priority import busy_wait_share, realtime_priority
from lidar_emu.transports.sockets import DatagramSocket


class Machine:
    """The real machine."""

    def __init__(self) -> None:
        self.clock = Clock()

    def start_port(self, descriptors: tuple[int, ...], errors: int) -> subprocess.Popen[bytes]:
        """Start the port process, with unbuffered pipes.

        Args:
            descriptors: what it inherits, closed here.
            errors: its standard error; the caller still owns it.
        """
        try:
            return subprocess.Popen(
                [sys.executable, "-P", "-m", "lidar_emu.runtime.port.process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                pass_fds=descriptors,
                start_new_session=True,
                bufsize=0,
            )
        finally:
            for descriptor in descriptors:
                os.close(descriptor)

    def datagram_socket(self, address: str) -> DatagramSocket:
        """A bound socket; arguments and errors as for `DatagramSocket`."""
        return DatagramSocket(address, self.clock.now_ns)

    def busy_wait_share(self) -> float:
        """Share of the time that a process may spend in busy waits."""
        return busy_wait_share()

    def realtime_priority(self) -> AbstractContextManager[None]:
        """Real-time priority in a context, where that is permitted."""
        return realtime_priority()

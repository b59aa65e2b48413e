"""The far end of the in-memory loopback, read in the model process as a host would read it."""

from __future__ import annotations

from lidar_emu.transports.serial_port import loopback_pair

_READ_BYTES = 65536


class LoopbackEnd:
    """The other end of the line. It must be read: an in-memory line can be full, too."""

    def __init__(self) -> None:
        self.device_end, self._socket = loopback_pair()
        """The end of the device; the caller closes it once the child has inherited it."""
        self._socket.setblocking(False)
        self._data = bytearray()

    def fileno(self) -> int:
        """Ready when there is something to drain."""
        return self._socket.fileno()

    def drain(self) -> None:
        """Read the received bytes."""
        try:
            while data := self._socket.recv(_READ_BYTES):
                self._data += data
        except (BlockingIOError, ConnectionResetError):
            return

    def take(self) -> bytes:
        """What was read since the last call."""
        data, self._data = bytes(self._data), bytearray()
        return data

    def close(self) -> None:
        """Close the socket; bytes already read can still be taken."""
        self._socket.close()

"""USB adapters that can be unplugged, and a program at the far end of their cable."""

from __future__ import annotations

import json
import os
import select
import termios
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from waiting import eventually

_LOOKS_MS = 100
"""How often the program at the far end looks whether it shall end."""


class Adapter(Protocol):
    """A USB adapter of the emulator, and the path of the far end of its cable."""

    path: str
    far_path: str

    def plug(self) -> None:
        """Plug the adapter in, and wait until the system has its port."""

    def unplug(self) -> None:
        """Pull the adapter out, and wait until the system has no port of it."""

    def close(self) -> None:
        """Leave it plugged in."""


class Gadget:
    """A CDC-ACM adapter: a gadget of this machine on the kernel's own USB controller, dummy_hcd."""

    path, far_path = "/dev/ttyACM0", "/dev/ttyGS0"
    _controller = Path("/sys/kernel/config/usb_gadget/serial/UDC")

    def __init__(self) -> None:
        eventually(Path(self.path).exists)

    def plug(self) -> None:
        """See `Adapter`."""
        self._controller.write_text("dummy_udc.0")
        eventually(Path(self.path).exists)

    def unplug(self) -> None:
        """See `Adapter`."""
        self._controller.write_text("\n")
        eventually(lambda: not Path("/sys/class/tty/ttyACM0").exists())

    def close(self) -> None:
        """See `Adapter`."""
        if not Path(self.path).exists():
            self.plug()


class Ftdi:
    """QEMU's FT232BM, driven by ftdi_sio; its cable ends in a port of this machine."""

    path = "/dev/ttyUSB0"

    def __init__(self) -> None:
        eventually(Path(self.path).exists)
        self.far_path = _virtio_port("far")
        self._monitor = os.open(_virtio_port("monitor"), os.O_RDWR)

    def plug(self) -> None:
        """See `Adapter`."""
        self._order("device_add", driver="usb-serial", chardev="far", id="adapter")
        eventually(Path(self.path).exists)

    def unplug(self) -> None:
        """See `Adapter`."""
        self._order("device_del", id="adapter")
        eventually(lambda: not Path("/sys/class/tty/ttyUSB0").exists())

    def close(self) -> None:
        """See `Adapter`."""
        if not Path(self.path).exists():
            self.plug()
        os.close(self._monitor)

    def _order(self, name: str, **arguments: Any) -> None:
        """An order to QEMU, in the protocol of its monitor (QMP)."""
        os.write(self._monitor, b'{"execute": "qmp_capabilities"}\n')
        os.write(self._monitor, json.dumps({"execute": name, "arguments": arguments}).encode() + b"\n")


def _virtio_port(name: str) -> str:
    for port in Path("/sys/class/virtio-ports").iterdir():
        if (port / "name").exists() and (port / "name").read_text().strip() == name:
            return f"/dev/{port.name}"
    raise AssertionError(f"the machine has no port {name}")


class FarProgram:
    """A program at the far end, which opens its port again whenever the cable was out."""

    def __init__(self, path: str) -> None:
        self.data = bytearray()
        self._path, self._over, self._descriptor = path, False, -1
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the program."""
        self._over = True
        self._thread.join()

    def send(self, data: bytes) -> None:
        """Write to the cable, once its port is open."""
        eventually(lambda: self._descriptor >= 0)
        os.write(self._descriptor, data)

    def wait_for_more(self, count: int) -> None:
        """Wait until this many more bytes have arrived."""
        before = len(self.data)
        eventually(lambda: len(self.data) >= before + count)

    def _read(self) -> None:
        while not self._over:
            with suppress(OSError, termios.error), _opened(self._path) as self._descriptor:
                self._read_open(self._descriptor)
            self._descriptor = -1
            threading.Event().wait(0.1)

    def _read_open(self, descriptor: int) -> None:
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        while not self._over:
            if poll.poll(_LOOKS_MS):
                if not (data := os.read(descriptor, 4096)):
                    return
                self.data += data


@contextmanager
def _opened(path: str) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        if os.isatty(descriptor):
            tty.setraw(descriptor)
        yield descriptor
    finally:
        os.close(descriptor)

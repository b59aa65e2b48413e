"""Tests on the CAN of a kernel, run by `machine`; elsewhere they are skipped, since they take interfaces down."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # can_tools.py is a module of these tests

_TOOLS = ("candump", "cansend", "cangen", "tshark", "tc", "ip")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Outside the machine, or without its tools, state the reason."""
    reason = ""
    if "SOCKETCAN_MACHINE" not in os.environ:
        reason = "needs SocketCAN: tests/integration/socketcan/machine .venv/bin/pytest tests/integration/socketcan"
    elif missing := [tool for tool in _TOOLS if shutil.which(tool) is None]:
        reason = f"not installed: {', '.join(missing)}"
    for item in items:
        if reason and Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture
def shape() -> Iterator[Callable[..., None]]:
    """Make vcan0 slow or lossy: arguments of `tc qdisc add dev vcan0 root`."""

    def add(*arguments: str) -> None:
        subprocess.run(["tc", "qdisc", "add", "dev", "vcan0", "root", *arguments], check=True)

    yield add
    subprocess.run(["tc", "qdisc", "del", "dev", "vcan0", "root"], check=True)


@pytest.fixture
def set_interface() -> Iterator[Callable[..., None]]:
    """`ip link set INTERFACE ...`; afterwards both are up and carry CAN FD."""

    def change(interface: str, *settings: str) -> None:
        subprocess.run(["ip", "link", "set", interface, *settings], check=True)

    yield change
    for interface in ("vcan0", "vcan1"):
        change(interface, "down")
        change(interface, "mtu", "72", "up")

"""Table of docs/view.md: what viewers that read, hang, flood or die change of a run, on an otherwise idle machine.

All cases are flown in turn, several times, so that a busy minute does not fall on one of them.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

import foxglove_client as clients  # noqa: E402
from free_ports import free_tcp_port  # noqa: E402

from lidar_emu.recording.read import read_recording  # noqa: E402

RATE_HZ = 100
ROUNDS, DURATION_S = 3, 15.0


class Flight(NamedTuple):
    """A run that goes on."""

    process: subprocess.Popen[bytes]
    port: int
    duration_s: float


def read_all(flight: Flight) -> None:
    """A program that reads what a viewer should be sent, as fast as it comes."""
    with clients.connect(flight.port) as connection:
        clients.send_text(connection, clients.subscription(list(range(1, 12))))
        with suppress(OSError):
            while connection.recv(1 << 20):
                pass


def hang(flight: Flight) -> None:
    """Three clients that subscribe to everything and read nothing."""
    connections = [clients.connect(flight.port) for _ in range(3)]
    for connection in connections:
        clients.send_text(connection, clients.subscription(list(range(1, 12))))
    flight.process.wait()
    for connection in connections:
        connection.close()


def flood(flight: Flight) -> None:
    """A client that sends messages without pause, and comes again when it is shut out."""
    while flight.process.poll() is None:
        with suppress(OSError), clients.connect(flight.port) as connection:
            for _ in range(10_000):
                clients.send_text(connection, '{"op": "no such thing"}' + 100 * " ")


def stop(flight: Flight) -> None:
    """The viewer, and what it has started, stand still."""
    for process in viewers(flight):
        os.kill(process, signal.SIGSTOP)


def kill(flight: Flight) -> None:
    """The viewer dies."""
    for process in viewers(flight):
        os.kill(process, signal.SIGKILL)


def nothing(flight: Flight) -> None:
    """A viewer is left to itself."""


def viewers(flight: Flight) -> list[int]:
    """The viewer's processes, the youngest first."""
    found = children(flight.process.pid)
    (viewer,) = [each for each in found if b"\0view\0" in Path(f"/proc/{each}/cmdline").read_bytes()]
    return [*children(viewer), viewer]


def children(process: int) -> list[int]:
    """Processes that a process has started."""
    return [int(each) for each in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


class Case(NamedTuple):
    """A row of the table."""

    name: str
    options: tuple[str, ...]
    disturb: Callable[[Flight], None]


CASES = (
    Case("no recording, no viewer", (), nothing),
    Case("recorded", ("--record", "{file}"), nothing),
    Case("Foxglove, a client that reads", ("--record", "{file}", "--view", "foxglove:{port}"), read_all),
    Case("Foxglove, three clients that hang", ("--record", "{file}", "--view", "foxglove:{port}"), hang),
    Case("Foxglove, a client that floods", ("--record", "{file}", "--view", "foxglove:{port}"), flood),
    Case("Foxglove, its server stopped", ("--record", "{file}", "--view", "foxglove:{port}"), stop),
    Case("Rerun for a browser", ("--record", "{file}", "--view", "web:{port}"), nothing),
    Case("Rerun, its processes stopped", ("--record", "{file}", "--view", "web:{port}"), stop),
    Case("Rerun, killed", ("--record", "{file}", "--view", "web:{port}"), kill),
)


def fly(case: Case, duration_s: float, folder: Path) -> dict[str, Any]:
    """The summary of a run, and what its packets are."""
    port, file, summary = free_tcp_port(), folder / "run.mcap", folder / "summary.json"
    for old in (file, summary):
        old.unlink(missing_ok=True)
    rate = ["--set", f"timing.rate_hz={RATE_HZ}", "--duration", str(duration_s), "--plain"]
    options = [each.format(file=file, port=port) for each in case.options]
    command = [sys.executable, "-m", "lidar_emu", "run", "descent.yaml", *rate, *options]
    with subprocess.Popen(
        [*command, "--summary", str(summary)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        flight = Flight(process, port, duration_s)
        if "--view" in options:
            wait_for(port)
        disturbing = threading.Thread(target=case.disturb, args=(flight,), daemon=True)
        disturbing.start()
        while not summary.exists() and process.poll() is None:
            time.sleep(0.1)
        process.terminate()  # the viewer is still open
    disturbing.join()
    payloads = read_recording(file).packets().payload if file.exists() else []
    digest = hashlib.sha256(b"".join(payloads)).hexdigest() if payloads else None
    return {**json.loads(summary.read_text()), "packets": digest}


def wait_for(port: int) -> None:
    """Wait until something listens."""
    while True:
        with suppress(OSError):
            clients.connect(port).close()
            return
        time.sleep(0.05)


def row(name: str, flown: list[dict[str, Any]], packets: set[str]) -> tuple[str, ...]:
    """A row of the table: medians over the flights, and the largest maximum."""
    late_us = {
        key: [flight["lateness"][f"{key}_ns"] / 1e3 for flight in flown] for key in ("p50", "p99", "max")
    }
    medians = (f"{np.median(late_us[key]):.0f}" for key in ("p50", "p99"))
    lost = sum(flight["shots"]["late"] + sum(flight["shots"]["dropped"].values()) for flight in flown)
    due = sum(flight["shots"]["due"] for flight in flown)
    received = {flight["packets"] for flight in flown} - {None}
    same = "-" if not received else "yes" if received == packets else "NO"
    return name, *medians, f"{max(late_us['max']):.0f}", f"{lost} of {due}", same


def parts() -> Iterator[tuple[str, ...]]:
    """Fly all cases in turn; the table."""
    flown: dict[str, list[dict[str, Any]]] = {case.name: [] for case in CASES}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(ROUNDS):
            for case in CASES:
                print(f"{number + 1} of {ROUNDS}: {case.name}", file=sys.stderr, flush=True)
                flown[case.name].append(fly(case, DURATION_S, Path(folder)))
    packets = {flight["packets"] for flight in flown["recorded"]}
    yield "", "p50, us", "p99, us", "max, us", "late or dropped", "the same packets"
    for case in CASES:
        yield row(case.name, flown[case.name], packets)

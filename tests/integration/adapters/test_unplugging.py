"""A USB adapter is pulled out in flight: the run continues, reports it, and sends again when the adapter is back."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from time import monotonic_ns
from typing import Any

import pytest
from programs import LONG_BENCH, Program, read_summary
from usb import Adapter, FarProgram, Gadget
from waiting import eventually

from lidar_emu.embedded_device import EmbeddedDevice
from lidar_protocol import Acknowledge, Host, Message, Received, SerialReceiver, default_interface

Start = Callable[..., Program]
PACKET_BYTES = 145
UNPLUGGED_S = 1.5
TONE_NS = 500_000_000_000
BENCH = [*LONG_BENCH, "--set", "timing.late_after_s=60", "--set", "device.housekeeping_rate_hz=0"]


@pytest.fixture
def far(adapter: Adapter) -> Iterator[FarProgram]:
    with closing(FarProgram(adapter.far_path)) as program:
        yield program


def received(far: FarProgram) -> list[Received]:
    return SerialReceiver(default_interface()).receive(bytes(far.data))


def events(summary: dict[str, Any]) -> list[str]:
    return [event["what"] for event in summary["link_events"] if "modem lines" not in event["what"]]


def test_the_run_continues_when_the_adapter_is_back(
    start: Start, adapter: Adapter, far: FarProgram, tmp_path: Path
) -> None:
    run = start("run", *BENCH, "--port", adapter.path, "--rs485", "--summary", "s.json", started=True)
    for _ in range(3):
        far.wait_for_more(10 * PACKET_BYTES)
        adapter.unplug()
        threading.Event().wait(UNPLUGGED_S)
        adapter.plug()
    far.wait_for_more(10 * PACKET_BYTES)
    run.signal(signal.SIGINT)
    run.succeed()
    summary = read_summary(tmp_path / "s.json")
    assert events(summary) == ["link broken: the device has gone", "reopened"] * 3
    shots, dropped = summary["shots"], summary["shots"]["dropped"]
    assert dropped["broken"] >= 3 * UNPLUGGED_S * summary["rate_hz"] - 3
    assert shots["due"] == shots["sent"] + shots["late"] + sum(dropped.values())
    numbers = [message.shot for message in received(far) if isinstance(message, Message)]
    assert numbers == sorted(set(numbers))
    assert 40 <= len(numbers) <= shots["sent"], "what was on its way is lost with the adapter"
    assert "low_latency" in summary["granted"]
    assert "rs485" in summary["missing"]


def test_an_adapter_that_does_not_come_back(
    start: Start, adapter: Adapter, far: FarProgram, tmp_path: Path
) -> None:
    """The run lasts as long as planned, and reports what was not sent."""
    run = start("run", *BENCH, "--duration", "5", "--port", adapter.path, "--summary", "s.json", started=True)
    far.wait_for_more(10 * PACKET_BYTES)
    adapter.unplug()
    run.succeed()
    summary = read_summary(tmp_path / "s.json")
    assert events(summary) == ["link broken: the device has gone"]
    assert summary["shots"]["due"] == 50
    assert summary["shots"]["dropped"]["broken"] > 10
    assert "link broken" in run.out


def test_listen_continues_when_the_adapter_is_back(start: Start, adapter: Adapter, far: FarProgram) -> None:
    shots = [each.payload for each in EmbeddedDevice("bench.yaml").advance(10**10) if each.kind == "shot"]
    listen = start("listen", "--port", adapter.path, "--plain", started=True)
    listen.word_after("listening on ")
    far.send(b"".join(shots[:3]))
    eventually(lambda: "shot      2" in listen.out)
    adapter.unplug()
    threading.Event().wait(UNPLUGGED_S)
    adapter.plug()
    eventually(lambda: far.send(shots[50]) or threading.Event().wait(0.2) or "shot     50" in listen.out)
    listen.signal(signal.SIGINT)
    assert listen.wait() == 0
    assert "the link broke 1 times" in listen.err


def test_the_time_is_that_at_the_last_pulse(start: Start, gadget: Gadget, tmp_path: Path) -> None:
    """A program that opens the far end raises the line CD; the port is found again after the adapter was out."""
    settings = ["--set", "device.clock.pulse_line=cd", "--port", gadget.path, "--summary", "s.json"]
    run = start("run", *BENCH, *settings, "--json", started=True)
    eventually(lambda: "ready" in run.out)
    host, number = Host(default_interface()), 0
    for _ in range(2):
        # An edge before the run has opened its port is none.
        with closing(FarProgram(gadget.far_path)) as far:
            far.wait_for_more(3 * PACKET_BYTES)
        before_edge_ns = monotonic_ns()
        with closing(FarProgram(gadget.far_path)) as far:
            far.wait_for_more(3 * PACKET_BYTES)
            after_edge_ns = monotonic_ns()
            threading.Event().wait(1.0)
            before_command_ns = monotonic_ns()
            far.send(host.encode_command("time_at_tone", sequence=number, tone_ns=TONE_NS))
            (answer,) = eventually(
                lambda far=far: [each for each in received(far) if isinstance(each, Acknowledge)]
            )
            heard_ns, number = monotonic_ns(), number + 1
        assert answer.verdict == "accepted"
        since_tone_ns = answer.values["time_ns"] - TONE_NS
        assert before_command_ns - after_edge_ns <= since_tone_ns <= heard_ns - before_edge_ns
        gadget.unplug()
        threading.Event().wait(UNPLUGGED_S)
        gadget.plug()
    run.signal(signal.SIGINT)
    run.succeed()
    found = events(read_summary(tmp_path / "s.json"))
    assert found.count("link broken: the device has gone") == 2
    assert "no pulses from line cd: No such device" in found

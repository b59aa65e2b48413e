"""Time at the tone by /dev/pps0, whose pulses the kernel gives and also states in /sys."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from programs import FarEnd, Program, read_summary
from waiting import eventually

from lidar_protocol import Acknowledge, Host, SerialReceiver, default_interface

Start = Callable[..., Program]
HOST = Host(default_interface())
S = 10**9
TONE_NS = 500 * S
STEP_NS = 1_000


def last_pulse_ns() -> int:
    """UTC of the last pulse, from the kernel: seconds.nanoseconds#number."""
    text = Path("/sys/class/pps/pps0/assert").read_text()
    return int(text.partition("#")[0].replace(".", ""))


def test_the_tone_is_the_last_pulse_of_the_kernel(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    settings = ["--set", "device.clock.pulse_line=/dev/pps0", "--baud", "921600", "--summary", "s.json"]
    run = start("run", "bench.yaml", *settings, "--port", far_end.path)
    far_end.wait_for(145)

    def answers() -> list[Acknowledge]:
        received = SerialReceiver(default_interface()).receive(bytes(far_end.data))
        return [message for message in received if isinstance(message, Acknowledge)]

    far_end.send(HOST.encode_command("no_op", sequence=0))
    for sequence in range(1, 100):
        pulse_ns, before_ns = last_pulse_ns(), time.time_ns()
        far_end.send(HOST.encode_command("time_at_tone", sequence=sequence, tone_ns=TONE_NS))
        eventually(lambda sequence=sequence: len(answers()) == sequence + 1)
        after_ns = time.time_ns()
        if (
            pulse_ns > 0 and last_pulse_ns() == pulse_ns
        ):  # else a pulse came in between, or there was none yet
            break
    answer = answers()[-1]
    assert answer.verdict == "accepted"
    since_tone_ns = answer.values["time_ns"] - TONE_NS
    assert before_ns - pulse_ns - STEP_NS <= since_tone_ns <= after_ns - pulse_ns + STEP_NS
    run.process.terminate()
    run.succeed()
    assert read_summary(tmp_path / "s.json")["link_events"] == []

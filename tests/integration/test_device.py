"""The device from the host's end: it boots, takes commands, restarts, keeps time, and begins a flight on command."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from programs import CommandingHost, FarEnd, Program, read_summary
from waiting import LIMIT_S, eventually

from lidar_protocol import Acknowledge, Host, Housekeeping, Message, SerialReceiver, default_interface

Start = Callable[..., Program]
INTERFACE = default_interface()
HOST = Host(INTERFACE)
# However busy the machine is, the descent outlasts the test, no shot is skipped as late, and a command has a second to
# change the shots that begin after it: a shot whose packet was due before its change was computed is missing.
QUICK = [
    "--set", "level=geometric", "--set", "site=flat", "--set", "timing.late_after_s=900",
    "--set", "trajectory.waypoints=[{altitude_m: 2000, speed_mps: 1}, {altitude_m: 200, speed_mps: 1}]",
    "--set", "timing.processing_latency_s=1", "--summary", "s.json",
]  # fmt: skip
LINK = ["--baud", "3000000"]


def settings(**values: Any) -> list[str]:
    return [word for key, value in values.items() for word in ("--set", f"{key.replace('__', '.')}={value}")]


def modes_of(messages: list[Any]) -> list[str]:
    """Without repetitions, in the order of the times that shots and housekeeping state.

    Housekeeping reports its instant, but waits for its turn: a shot of a later one may be out before it.
    """
    reported = [(m.time_ns, m.header["mode"]) for m in messages if isinstance(m, Message)]
    reported += [(m.values["time_ns"], m.values["mode"]) for m in messages if isinstance(m, Housekeeping)]
    return [
        str(INTERFACE.word("mode", int(number)))
        for number, _ in groupby(mode for _, mode in sorted(reported))
    ]


def steps_ms(shots: list[Message]) -> list[int]:
    return [round((b.time_ns - a.time_ns) / 1e6) for a, b in pairwise(shots)]


def fired(shot: Message) -> tuple[bool, ...]:
    return tuple(bool(beam["fired"]) for beam in shot.beams)


@pytest.mark.slow
def test_from_power_up_to_track_and_back(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    run = start("run", "descent.yaml", *QUICK, "--port", far_end.path, *LINK, "--record", "flight.mcap",
                *settings(device__start="boot", device__boot_s=0.4, device__self_test_s=1, timing__rate_hz=100,
                          device__acquisition_s=0.5, device__housekeeping_rate_hz=10))  # fmt: skip
    host = CommandingHost(far_end)
    host.wait_for_mode("standby")
    assert host.all(Message) == []
    assert host.command("set_mode", mode="track") == "accepted"
    host.wait_for_mode("track")
    assert host.command("set_rate_hz", rate_hz=25) == "accepted"
    eventually(lambda: steps_ms(host.all(Message))[-1:] == [40])
    assert host.command("enable_beams", beams=0b0110) == "accepted"
    eventually(lambda: fired(host.all(Message)[-1]) == (False, True, True, False))
    assert host.command("set_mode", mode="safe") == "accepted"
    host.wait_for_mode("safe")
    run.signal(signal.SIGINT)
    run.succeed()
    assert modes_of(host.received) == ["self_test", "standby", "acquire", "track", "safe"]
    shots = host.all(Message)
    assert [shot.shot for shot in shots] == list(range(len(shots))), "the device counts what it fires"
    assert [step for step, _ in groupby(steps_ms(shots)) if step in (10, 40)] == [10, 40]
    assert [beams for beams, _ in groupby(map(fired, shots))] == [(True,) * 4, (False, True, True, False)]
    reported = read_summary(tmp_path / "s.json")
    assert reported["shots"]["sent"] == len(shots)
    assert (
        reported["shots"]["sent"] + reported["shots"]["suppressed"] + reported["shots"]["late"]
        == reported["shots"]["due"]
    )
    assert reported["faults"]["suppressed"] == 0
    assert reported["housekeeping"]["sent"] == len(host.all(Housekeeping))
    _check_recording(tmp_path / "flight.mcap", host)


def _check_recording(path: Path, host: CommandingHost) -> None:
    with path.open("rb") as file:
        messages = [
            (channel.topic, message.data) for _, channel, message in make_reader(file).iter_messages()
        ]
    commands = [json.loads(data) for topic, data in messages if topic == "/command"]
    assert [each["command"] for each in commands] == ["set_mode", "set_rate_hz", "enable_beams", "set_mode"]
    assert commands[0]["values"] == {"mode": "track"}
    deliveries = [json.loads(data) for topic, data in messages if topic == "/delivery"]
    sent = [delivery["shot"] for delivery in deliveries if delivery["status"] == "sent"]
    assert commands[0]["first_shot"] == sent[0]
    kept = b"".join(data for topic, data in messages if topic == "/housekeeping")
    assert list(SerialReceiver(INTERFACE).receive(kept)) == host.all(Housekeeping)


def test_send_again_and_again_from_new_processes(start: Start, tmp_path: Path) -> None:
    run = start("run", "descent.yaml", *QUICK, "--port", "pty", *LINK, *settings(device__start="standby"))
    path = run.word_after("descent on ")
    for words, code, answers in (
        (["set_mode", "mode=acquire"], 0, ["set_mode mode=acquire: accepted at "]),
        (["set_rate_hz", "rate_hz=10", "set_pattern", "pattern=1"], 0, ["accepted", "accepted"]),
        (["set_pattern", "pattern=9", "no_op"], 1, ["out of range"]),
        (["enable_beams", "beams=0b0011"], 0, ["enable_beams beams=3: accepted"]),
        (["--sequence", "77", "enable_beams", "beams=1"], 1, ["bad sequence"]),
        (["--json", "no_op"], 0, ['"verdict": "accepted"']),
        (["--sequence", "0", "no_op"], 0, ["no_op: accepted"]),
        (["set_mode", "mode=standby"], 0, ["accepted"]),  # its own no_op has number 0, too
    ):
        send = start("send", "--port", path, *words)
        assert send.wait() == code, send.err
        lines = send.out.splitlines()
        assert len(lines) == len(answers)
        assert all(part in line for part, line in zip(answers, lines, strict=True))
    run.signal(signal.SIGINT)
    run.succeed()
    reported = read_summary(tmp_path / "s.json")["commands"]
    assert reported["rejected"] == {"bad_sequence": 2, "out_of_range": 1}
    assert "accepted, bad sequence 2, out of range 1" in run.out


def test_send_states_when_nobody_answers(start: Start, far_end: FarEnd) -> None:
    send = start("send", "--port", far_end.path, "--timeout", "0.2", "set_mode", "mode=track")
    assert send.wait() == 1
    assert send.out == "no_op: no acknowledgement\n"


def test_a_flight_on_command(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    run = start("run", "descent.yaml", *QUICK, "--duration", "2", "--start", "on-command",
                "--port", far_end.path, *LINK,
                *settings(timing__rate_hz=50, device__housekeeping_rate_hz=10, device__acquisition_s=0.3))  # fmt: skip
    host = CommandingHost(far_end)
    host.wait_for_mode("standby")
    assert "waits for set_mode acquire or track" in run.out
    assert host.command("set_pattern", pattern=1) == "accepted"
    eventually(lambda: len(host.all(Housekeeping)) > 4)
    assert host.all(Message) == []
    assert host.command("set_mode", mode="track") == "accepted"
    run.succeed()
    shots, answers = host.all(Message), host.all(Acknowledge)
    reported = read_summary(tmp_path / "s.json")
    assert len(shots) == 100 - reported["shots"]["late"]
    assert shots[0].beams[0]["range_m"] == pytest.approx(2000 / 0.99144, rel=1e-3), (
        "from where the descent begins"
    )
    assert shots[0].beams[0]["beam_angle_deg"] == 7.5
    # The device's clock has run since power-up: it goes on.
    began_s = (shots[0].time_ns - answers[-1].values["time_ns"]) * 1e-9
    assert 0.09 < began_s < LIMIT_S
    times_ns = [m.values["time_ns"] for m in host.all(Housekeeping)]
    assert times_ns == sorted(times_ns)
    assert modes_of(host.received) == ["standby", "acquire", "track"]

"""The example receivers follow a whole descent with faults and commands: their logs match the recording."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from decimal import ROUND_FLOOR, Decimal
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import handwritten
import pytest
from mcap.reader import make_reader
from programs import FarEnd, Program, read_summary
from waiting import LIMIT_S

import lidar_protocol

ROOT = Path(__file__).resolve().parents[2]
RECEIVERS = ROOT / "examples" / "receivers"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
IN_PYTHON = [sys.executable, "-I", "-S", str(RECEIVERS / "receiver.py")]
STRICT = ["-std=c99", "-pedantic", "-O1", "-Wall", "-Wextra", "-Werror", "-fsanitize=undefined,address"]
EPOCH_NS = 1_893_456_000 * 10**9  # 2030-01-01, the default of timing.epoch

Start = Callable[..., Program]

FAULTS = """[
    {kind: lost, probability: 0.2, from_s: 1.8, to_s: 3.6},
    {kind: wrong_crc, probability: 0.2, from_s: 4.05, to_s: 5.85},
    {kind: doubled, probability: 0.2, from_s: 6.3, to_s: 8.1},
    {kind: truncated, probability: 0.1, keep: 0.7, from_s: 8.55, to_s: 10.35},
    {kind: time_jump, jump_s: 1.5, from_s: 10.8, to_s: 11.7},
    {kind: frozen_counter, from_s: 12.15, to_s: 12.38},
    {kind: dropout, beams: [2], from_s: 12.6, to_s: 13.95},
    {kind: bias, range_m: -2.5, closing_speed_mps: 0.1, from_s: 14.4, ramp_s: 1},
    {kind: stale_packet, from_s: 16.2, to_s: 16.43}
]"""
QUICK_DESCENT = (
    "{kind: profile, waypoints: [{altitude_m: 1500, speed_mps: 160}, {altitude_m: 20, speed_mps: 5}]}"
)
"""By the clock: at another pace a device in standby would end its flight before the command to continue."""
ORDERS = ["300:set_pattern=1", "500:no_op", "650:set_mode=1", "650:set_mode=4", "850:set_pattern=0"]

NUMBERS = {  # typed from INTERFACE.md: step, lowest, highest, whether a value outside is held
    "snr_db": ("0.01", "-327.67", "327.67", True),
    "range_m": ("0.001", "0", "4294967.294", False),
    "closing_speed_mps": ("0.0001", "-214748.3647", "214748.3647", False),
    "second_range_m": ("0.001", "0", "4294967.294", False),
    "sigma_range_m": ("0.0001", "0", "6.5534", True),
    "sigma_speed_mps": ("0.00001", "0", "0.65534", True),
    "residual_mps": ("0.0001", "-3.2767", "3.2767", True),
    "beam_angle_deg": ("0.01", "0", "90", False),
    "second_sigma_range_m": ("0.0001", "0", "6.5534", True),
}
COPIED = ("fired", "range_valid", "speed_valid", "sign_resolved", "segments", "reason", "second_reason")


def quantised(value: float | None, step: str, lowest: str, highest: str, is_held: bool) -> str | None:
    """What arrives of a value, in decimal digits."""
    if value is None:
        return None
    unit = Decimal(step)
    sent = (Decimal(value) / unit + Decimal("0.5")).to_integral_value(ROUND_FLOOR) * unit
    if is_held:
        sent = min(max(sent, Decimal(lowest)), Decimal(highest))
    decimals = len(step) - len("0.")
    return f"{sent:.{decimals}f}" if Decimal(lowest) <= sent <= Decimal(highest) else None


def as_time_code(time_ns: int) -> int:
    """Nanoseconds through 24 bits of a second."""
    ticks = (2 * time_ns * 2**24 + 10**9) // (2 * 10**9)
    return (2 * ticks * 10**9 + 2**24) // 2**25


def expected_message(
    shot: int, time_ns: int, due_ns: int, mode: int, measured: dict[str, Any]
) -> dict[str, Any]:
    beams = []
    for k, second_s in enumerate(measured["time_s"]):
        beam: dict[str, Any] = {"beam": k, **{name: measured[name][k] for name in COPIED}}
        beam["returns"] = min(measured["returns"][k], 15)
        beam |= {name: quantised(measured[name][k], *limits) for name, limits in NUMBERS.items()}
        offset_s = second_s - min(measured["time_s"])
        beams.append(beam | {"time_offset_s": quantised(offset_s, "0.000001", "0", "4294", False)})
    return {
        "kind": "measurement", "unit": 0, "shot": shot, "time_ns": as_time_code(time_ns),
        "due_ns": as_time_code(due_ns),
        "pattern": measured["pattern"], "mode": mode, "laser_on": True, "clock_locked": True, "beams": beams,
    }  # fmt: skip


class Shot(NamedTuple):
    """What the recording has of a shot."""

    time_ns: int
    measured: dict[str, Any]
    delivery: dict[str, Any]
    faults: set[str]
    packet: bytes


def recorded(path: Path) -> Iterator[Shot]:
    """The shots of a recording."""
    faults: dict[int, set[str]] = defaultdict(set)
    topics: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    packets: dict[int, bytes] = {}
    for _, channel, message in make_reader(io.BytesIO(path.read_bytes())).iter_messages():
        if channel.topic == "/fault":
            reported = json.loads(message.data)
            faults[reported["shot"]].add(reported["kind"])
        elif channel.topic == "/packet":
            packets[message.sequence] = message.data
        elif channel.topic in ("/measurement", "/delivery"):
            topics[channel.topic].append((message.log_time - EPOCH_NS, json.loads(message.data)))
    for (time_ns, measured), (_, delivery) in zip(topics["/measurement"], topics["/delivery"], strict=True):
        shot = delivery["shot"]
        assert set(measured["shot"]) == {shot}
        yield Shot(time_ns, measured, delivery, faults[shot], packets.get(shot, b""))


def sent_frames(path: Path) -> Iterator[dict[str, Any] | None]:
    """What a receiver makes of each frame on the wire, by the record, fault by fault; None: it is damaged."""
    last: dict[str, Any] = {}
    silent = 0  # shots that a mode leaves out, which the device does not count
    for time_ns, measured, delivery, faults, packet in recorded(path):
        assert delivery["status"] == ("sent" if packet else "suppressed")
        assert not ("lost" in faults and packet)
        if not packet:
            silent += "lost" not in faults
            continue
        is_whole = not faults & {"wrong_crc", "truncated"}
        mode = handwritten.decoded(handwritten.unstuffed(packet)[0])[0]["mode"] if is_whole else 0
        message = expected_message(delivery["shot"] - silent, time_ns, delivery["due_ns"], mode, measured)
        if "time_jump" in faults:
            message["time_ns"] = as_time_code(time_ns + 1_500_000_000)
        if "frozen_counter" in faults:
            message["shot"] = last["shot"]
        if "stale_packet" in faults:
            message = last
        yield message if is_whole else None
        if "doubled" in faults:
            yield message
        last = message


def told_of_itself(path: Path) -> list[Mapping[str, Any]]:
    """The housekeeping of a recording, decoded by the library."""
    messages = make_reader(io.BytesIO(path.read_bytes())).iter_messages(topics=["/housekeeping"])
    receiver = lidar_protocol.SerialReceiver(lidar_protocol.default_interface())
    received = receiver.receive(b"".join(message.data for _, _, message in messages))
    return [each.values for each in received if isinstance(each, lidar_protocol.Housekeeping)]


def gaps(shots: list[int]) -> dict[str, int]:
    steps = [after - before - 1 for before, after in pairwise(shots)]
    missing = [step for step in steps if step > 0]
    return {"gaps": len(missing), "lost_shots": sum(missing), "repeats": sum(step < 0 for step in steps)}


@pytest.fixture(scope="module")
def in_c(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The command that starts the receiver in C."""
    if COMPILER is None:
        pytest.skip("there is no C compiler on this machine")
    program = tmp_path_factory.mktemp("c") / "receiver"
    header = Path(lidar_protocol.__file__).parent
    source = [str(RECEIVERS / "receiver.c"), f"-I{header}", "-o", str(program)]
    subprocess.run([COMPILER, *STRICT, *source], check=True)
    return [str(program)]


@pytest.fixture(params=["c", "python"])
def receiver(request: pytest.FixtureRequest) -> list[str]:
    """The command that starts a receiver."""
    return request.getfixturevalue("in_c") if request.param == "c" else IN_PYTHON


@pytest.mark.slow
def test_a_whole_descent_with_commands_and_faults(receiver: list[str], start: Start, tmp_path: Path) -> None:
    start("scenarios").succeed()
    # Time for the receiver to open the pty: it has to have the first shot, too.
    begin = (datetime.now(UTC) + timedelta(seconds=8)).isoformat()
    run = start(
        "run", "descent.yaml", "--port", "pty", "--baud", "921600", "--set", f"trajectory={QUICK_DESCENT}",
        "--set", "timing.rate_hz=60", "--set", "timing.late_after_s=60", "--set", f"faults={FAULTS}",
        "--set", "device.housekeeping_rate_hz=3", "--record", "r.mcap", "--summary", "s.json", "--start", begin,
    )  # fmt: skip
    path = run.word_after("descent on ")
    following = subprocess.run(
        [*receiver, path, "921600", *ORDERS], stdout=subprocess.PIPE, timeout=LIMIT_S, check=True
    )
    run.succeed()
    lines = [json.loads(line, parse_float=str) for line in following.stdout.splitlines()]
    by_kind = {
        kind: [line for line in lines if line["kind"] == kind] for kind in {line["kind"] for line in lines}
    }
    frames = list(sent_frames(tmp_path / "r.mcap"))
    expected, damaged = [message for message in frames if message is not None], frames.count(None)
    logged = by_kind["measurement"]
    for a, b in zip(logged, expected, strict=False):
        assert a == b
    assert len(logged) == len(expected)
    (end,) = by_kind["end"]
    assert lines[-1] == end
    assert (end["measurements"], end["bad_frames"]) == (len(expected), damaged)
    assert damaged > 10
    assert gaps([message["shot"] for message in expected]).items() <= end.items()

    expected_health = told_of_itself(tmp_path / "r.mcap")
    assert len(by_kind["housekeeping"]) == len(expected_health) > 40
    for line, health in zip(by_kind["housekeeping"], expected_health, strict=True):
        for name in line.keys() - {"kind", "unit"}:
            assert line[name] is health[name] is None or float(line[name]) == health[name], name

    answers = [(line["command"], line["sequence"], line["verdict"]) for line in by_kind["acknowledge"]]
    assert answers == [(2, 0, 0), (0, 1, 0), (1, 2, 0), (1, 3, 0), (2, 4, 0)]
    reported = read_summary(tmp_path / "s.json")
    assert reported["commands"]["accepted"] == 5
    assert reported["shots"]["due"] == reported["planned_shots"] > 1000
    assert len(reported["faults"]["shots"]) == FAULTS.count("kind:")
    assert [mode for mode, _ in groupby(line["mode"] for line in logged)] == [4, 3, 4]
    angles = [beam["beam_angle_deg"] for beam in (line["beams"][0] for line in logged)]
    assert [angle for angle, _ in groupby(angles)] == ["22.50", "7.50", "22.50"]


@pytest.mark.slow
def test_a_device_that_boots_is_asked_until_it_follows(receiver: list[str], start: Start) -> None:
    booting = (
        "device={start: boot, boot_s: 0.5, self_test_s: 1.0, acquisition_s: 0.2, housekeeping_rate_hz: 5}"
    )
    run = start("run", "descent.yaml", "--duration", "4.5", "--port", "pty", "--set", booting)
    port = run.word_after("descent on ")
    command = [*receiver, port, "921600", "0:set_mode=4"]
    following = subprocess.run(command, stdout=subprocess.PIPE, timeout=LIMIT_S, check=True)
    run.succeed()
    lines = [json.loads(line) for line in following.stdout.splitlines()]
    verdicts = [line["verdict"] for line in lines if line["kind"] == "acknowledge"]
    assert verdicts[-1] == 0
    assert set(verdicts[:-1]) <= {4}
    modes = [mode for mode, _ in groupby(line["mode"] for line in lines if "mode" in line)]
    assert modes == [2, 1, 3, 4]
    assert {line["mode"] for line in lines if line["kind"] == "measurement"} == {3, 4}


def test_both_say_the_same_of_anything(in_c: list[str], start: Start, far_end: FarEnd) -> None:
    """A captured stream with every byte that noise can hold: the two programs agree line by line."""
    noise = "[{kind: bit_errors, rate: 1e-4}, {kind: garbage, bytes: 300, probability: 0.2}]"
    run = start(
        "run", "descent.yaml", "--pace", "max", "--duration", "10", "--port", far_end.path, "--set", f"faults={noise}"
    )  # fmt: skip
    run.succeed()
    interface = lidar_protocol.default_interface()
    assert interface.housekeeping is not None
    reported = {name: 50 + k for k, name in enumerate(sorted(interface.housekeeping.names))}
    reported |= {
        "temperature_c": -12.34,
        "laser_power_w": None,
        "interlock_closed": True,
        "laser_on": False,
        "clock_locked": True,
    }
    health = lidar_protocol.Device(interface, 15).housekeeping(9, reported)
    stream = bytes(far_end.data) + b"\x55" * 5000 + b"\0" + bytes(range(256)) + health
    stated = [
        subprocess.run([*command, "-", "9600"], input=stream, capture_output=True, check=True)
        for command in (in_c, IN_PYTHON)
    ]
    assert stated[0].stdout == stated[1].stdout
    *_, health_line, end = map(json.loads, stated[0].stdout.splitlines())
    assert (health_line.pop("kind"), health_line.pop("unit"), health_line.pop("time_ns")) == (
        "housekeeping",
        15,
        60,
    )
    assert health_line == {name: reported[name] for name in health_line}
    assert len(health_line) >= 12
    assert end["bad_frames"] > 10
    assert end["measurements"] > 100


@pytest.mark.parametrize(
    "order",
    [
        "5:set_pattern=256",
        "5:jump=1",
        "set_pattern=1",
        "5:set_rate_hz=-1",
        "5:set_mode=abc",
        "5:set_mode=1x",
        "-1:no_op",
        "5:",
    ],
)
def test_orders_that_cannot_be_sent_are_refused(receiver: list[str], order: str) -> None:
    refused = subprocess.run([*receiver, "-", "9600", order], stdin=subprocess.DEVNULL, capture_output=True)
    assert refused.returncode in (1, 2)
    assert order.encode() in refused.stderr
    assert refused.stdout == b""

"""A device in a simulator of one's own: the packets of a run, commands in between, truth from the caller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from lidar_emu import EmbeddedDevice, InputError, read_recording, simulate
from lidar_emu.cli import cli
from lidar_emu.embedded_device import DuePacket
from lidar_emu.recording.channels import HOUSEKEEPING
from lidar_protocol import Acknowledge, Host, Message, SerialReceiver, default_interface

SECOND_NS = 10**9
SCENARIO: dict[str, Any] = {"site": "flat", "duration_s": 3, "device.housekeeping_rate_hz": 2}


def flown(device: EmbeddedDevice, step_ns: int) -> list[DuePacket]:
    packets: list[DuePacket] = []
    time_ns = 0
    while not device.is_over:
        time_ns += step_ns
        packets += device.advance(time_ns)
    return packets


@pytest.mark.parametrize(
    "faults", ["[]", "[{kind: lost, probability: 0.2}, {kind: delayed, probability: 0.3, delay_s: 0.2}]"]
)
def test_packets_are_those_of_a_run(tmp_path: Path, faults: str) -> None:
    overrides = SCENARIO | {"faults": faults}
    settings = [word for key, value in overrides.items() for word in ("--set", f"{key}={value}")]
    file = str(tmp_path / "run.mcap")
    done = CliRunner().invoke(
        cli, ["run", "descent", *settings, "--pace", "max", "--plain", "--record", file]
    )
    assert done.exit_code == 0, done.output
    recording = read_recording(file)
    recorded, stated = recording.packets(), recording.raw_messages(HOUSEKEEPING)
    expected = [(int(due), data) for due, data in zip(recorded.due_ns, recorded.payload, strict=True) if data]
    for step_ns in (SECOND_NS // 7, 10 * SECOND_NS):
        sent = flown(EmbeddedDevice("descent", overrides), step_ns)
        shots = [(each.due_ns, each.payload) for each in sent if each.kind == "shot"]
        assert shots == expected
        housekeeping = [each.payload for each in sent if each.kind == "housekeeping"]
        assert housekeeping == [message.payload for message in stated]
        assert len(housekeeping) >= 6


def test_measurements_are_those_of_simulate() -> None:
    device = EmbeddedDevice("descent", SCENARIO)
    shots = [each.measurement for each in flown(device, SECOND_NS) if each.measurement is not None]
    run = simulate("descent", SCENARIO)
    np.testing.assert_array_equal(np.concatenate([shot.range_m for shot in shots]), run.range_m)
    assert device.advance(10 * SECOND_NS) == []
    assert device.next_ns is None


def test_commands_affect_the_shots_that_begin_after_them() -> None:
    device = EmbeddedDevice("descent", SCENARIO | {"device.housekeeping_rate_hz": 0})
    before = device.advance(SECOND_NS)
    data = Host(default_interface()).encode_command("set_pattern", sequence=0, pattern=1)
    assert device.receive(data[:5], SECOND_NS) == []
    (answer,) = device.receive(data[5:], SECOND_NS + 10_000_000)
    after = device.advance(3 * SECOND_NS)
    receiver = SerialReceiver(default_interface())
    (message,) = receiver.receive(answer.payload)
    assert isinstance(message, Acknowledge)
    assert message.values["verdict"] == default_interface().enumerations["verdict"]["accepted"]
    angles = {
        shot: beams[0]["beam_angle_deg"]
        for packet in (*before, *after)
        for shot, beams in [_decoded(receiver, packet)]
    }
    assert [angles[shot] for shot in (0, 20, 21, 59)] == pytest.approx([22.5, 22.5, 7.5, 7.5])


def _decoded(receiver: SerialReceiver, packet: DuePacket) -> tuple[int, Any]:
    (message,) = receiver.receive(packet.payload)
    assert isinstance(message, Message)
    assert message.shot is not None
    return message.shot, message.beams


def test_truth_of_the_caller_is_measured() -> None:
    """A fall from 1000 m at 30 m/s: the beams at 22.5 degrees see height / cos, whatever the time of the truths."""
    device = EmbeddedDevice("live", {"site": "flat", "level": "geometric", "duration_s": 2})
    down = (0.0, 2**-0.5, 2**-0.5, 0.0)  # body x north, z down
    shots, newest_ns = [], -1
    while (next_ns := device.next_ns) is not None:
        if next_ns > newest_ns:
            device.set_truth(next_ns, (0, 0, 1000 - 30 * next_ns * 1e-9), (0, 0, -30), down)
            newest_ns = next_ns
        shots += [each.measurement for each in device.advance(next_ns) if each.measurement is not None]
    assert len(shots) == 2 * device.scenario.timing.rate_hz
    for shot in shots:
        height_m = 1000 - 30 * shot.time_ns * 1e-9
        slant = 1 / np.cos(np.radians(shot.beam_angle_deg))
        np.testing.assert_allclose(shot.range_m, height_m * slant, rtol=1e-9)
        np.testing.assert_allclose(shot.closing_speed_mps, 30 / slant, rtol=1e-9)
        np.testing.assert_allclose(shot.truth.site_from_body, [down], atol=1e-12)


WHOLE_NS = "advance: time_ns: must be a whole number of nanoseconds, 0 or later"


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda device: device.advance(-1), f"{WHOLE_NS} (got -1)"),
        (lambda device: device.advance(1.5), f"{WHOLE_NS} (got 1.5)"),
        (lambda device: device.advance(10**9), "advance: no truth was given yet; call set_truth first"),
        (lambda device: device.receive("abc", 0), "receive: data: must be bytes (got 'abc')"),
        (
            lambda device: device.set_truth(0, (0, 0), (0, 0, 0), (1, 0, 0, 0)),
            "set_truth: position_site_m: must be 3 numbers (got [0, 0])",
        ),
        (
            lambda device: device.set_truth(0, (0, 0, 9), (0, 0, 0), (1, 1, 0, 0)),
            "set_truth: time_ns: bad attitude; pass a unit quaternion",
        ),
    ],
)
def test_refusals_are_one_line(call: Any, line: str) -> None:
    with pytest.raises(InputError) as refused:
        call(EmbeddedDevice("live", site="flat", level="geometric"))
    assert str(refused.value).startswith(line)

"""Bytes against golden.json, which a script with `struct` alone has written."""

import json
import runpy
from pathlib import Path

import pytest

from lidar_protocol import CanReceiver, Device, default_interface

HERE = Path(__file__).parent
SHOTS = json.loads((HERE / "golden.json").read_text(encoding="utf-8"))
CORE_BEAM = ["range_valid", "speed_valid", "sign_resolved", "segments", "range_m", "closing_speed_mps"]
NAMES = [shot["name"] for shot in SHOTS]


def test_the_golden_file_is_what_its_script_writes():
    script = runpy.run_path(str(HERE / "make_golden.py"))
    assert [shot | script["encoded"](shot) for shot in script["SHOTS"]] == SHOTS


@pytest.mark.parametrize("shot", SHOTS, ids=NAMES)
def test_a_device_sends_the_golden_bytes(shot):
    device = Device(default_interface(), shot["unit"])
    assert device.serial_bytes(shot["header"], shot["beams"]).hex() == shot["frame"]
    for can_set, frames in shot["can"].items():
        sent = device.can_frames(can_set, shot["header"], shot["beams"])
        assert [[frame.can_id, frame.data.hex()] for frame in sent] == frames
        assert {(frame.is_fd, frame.bitrate_switch) for frame in sent} == {(can_set == "fd",) * 2}


@pytest.mark.parametrize("can_set", ["full", "fd"])
@pytest.mark.parametrize("shot", SHOTS, ids=NAMES)
def test_a_host_reads_everything_from_a_full_or_fd_set(shot, can_set):
    check_whole(received(shot, can_set), shot, snr_step=1.0 if can_set == "full" else 0.01)


@pytest.mark.parametrize("shot", SHOTS, ids=NAMES)
def test_a_host_reads_the_measurement_from_a_core_set(shot):
    message = received(shot, "core")
    assert message.unit == shot["unit"]
    assert message.time_ns == pytest.approx(shot["header"]["time_ns"], abs=30)
    assert message.due_ns is None
    assert message.shot is None
    for beam, given in zip(message.beams, shot["beams"], strict=True):
        assert beam["fired"] == given["fired"]
        assert [beam[name] for name in CORE_BEAM if given["fired"]] == [
            given[name] for name in CORE_BEAM if given["fired"]
        ]


def received(shot, can_set):
    receiver = CanReceiver(default_interface())
    messages = [
        message
        for can_id, data in shot["can"][can_set]
        for message in receiver.receive(can_id, bytes.fromhex(data), can_set == "fd")
    ]
    assert len(messages) == 1
    return messages[0]


def check_whole(message, shot, snr_step=0.01):
    assert message.unit == shot["unit"]
    assert message.shot == shot["header"]["shot"]
    assert message.time_ns == pytest.approx(shot["header"]["time_ns"], abs=30)
    assert message.due_ns == pytest.approx(shot["header"]["due_ns"], abs=30)
    for name in ("mode", "laser_on", "clock_locked"):
        assert message.header[name] == shot["header"][name]
    for beam, given in zip(message.beams, shot["beams"], strict=True):
        if given["snr_db"] is not None:
            assert beam["snr_db"] == pytest.approx(given["snr_db"], abs=snr_step / 2)
        for name in given.keys() - {"snr_db"}:
            assert beam[name] == given[name], name

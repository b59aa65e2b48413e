"""What benchmarks/protocol.py compares is equal, bit by bit, and it prints its measurements."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from benchmarks import protocol
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import Wire
from lidar_emu.shots.model import build_model, measure_whole
from lidar_emu.wire import Encoder
from lidar_protocol import SerialReceiver, default_interface

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")


@pytest.mark.parametrize("scenario", ["descent.yaml", "dust_storm.yaml"])
def test_the_encoder_in_c_gives_the_same_packets(scenario: str, tmp_path: Path) -> None:
    measurement = measure_whole(build_model(load(scenario, {"duration_s": "3"})))
    assert 0 < measurement.range_valid.sum() < measurement.range_valid.size
    codec = protocol.CompiledCodec(default_interface(), measurement, tmp_path)
    packets = list(Encoder(Wire(), False, False, measurement.range_m.shape[1]).packets(measurement))
    assert codec.encode(measurement) == packets
    receiver = SerialReceiver(default_interface())
    for packet in packets:
        (message,) = receiver.receive(packet)
        assert codec.decode(packet) == sum(beam["range_valid"] for beam in message.beams)


def test_every_cost_is_reported(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(protocol, "ROUNDS", 1)
    protocol.main()
    *rows, ratio = capsys.readouterr().out.splitlines()[2:]
    assert len(rows) == 3 + 2 * 3 + 7
    assert all(float(row.split("|")[2]) > 0.0 for row in rows)
    assert float(ratio.split()[1]) > 0.0

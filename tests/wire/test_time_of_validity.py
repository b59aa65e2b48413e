"""The time of validity of each beam survives the wire, whichever beam fired first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import lidar_emu
from lidar_emu.measurement import Measurement
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import Wire
from lidar_emu.wire import Encoder, rows
from lidar_protocol import CanReceiver, Message, SerialReceiver, default_interface

BENCH = """
name: three beams
bench_pattern:
  duration_s: 0.1
  beams:
    - {range_m: 1000, closing_speed_mps: 10}
    - {range_m: 900, closing_speed_mps: 0}
    - {range_m: 800, closing_speed_mps: 5}
"""
TICK_NS = 1e9 / 2**24
"""Resolution of the time of a packet; an offset has 1 us."""


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Measurement:
    path = tmp_path_factory.mktemp("bench") / "bench.yaml"
    path.write_text(BENCH)
    return lidar_emu.simulate(load(path))


def received(measured: Measurement, link: str) -> list[Message]:
    encoder = Encoder(Wire(can_messages="full"), link != "serial", link == "fd", measured.beam_count)
    messages: list[object] = []
    if link == "serial":
        receiver = SerialReceiver(default_interface())
        for packet in encoder.packets(measured):
            assert isinstance(packet, bytes)
            messages += receiver.receive(packet)
    else:
        bus = CanReceiver(default_interface())
        for frames in encoder.packets(measured):
            messages += [m for f in frames for m in bus.receive(f.can_id, f.data, f.is_fd)]  # type: ignore[union-attr]
    return [message for message in messages if isinstance(message, Message)]


@given(st.lists(st.integers(0, 1_000_000), min_size=3, max_size=3), st.sampled_from(["serial", "full", "fd"]))
def test_packet_time_and_offset_add_up_to_the_time_of_validity(
    measured: Measurement, after_ns: list[int], link: str
) -> None:
    start_ns = np.arange(len(measured), dtype=np.int64)[:, None] * 50_000_000
    times_ns = start_ns + np.array(after_ns, dtype=np.int64)
    messages = received(replace(measured, time_ns=times_ns), link)
    assert len(messages) == len(measured)
    for message, expected_ns in zip(messages, times_ns, strict=True):
        assert message.time_ns == pytest.approx(expected_ns.min(), abs=TICK_NS)
        decoded_s = [row["time_s"] for row in rows(message)]
        np.testing.assert_allclose(decoded_s, expected_ns * 1e-9, rtol=0, atol=0.5e-6 + TICK_NS * 1e-9)

"""The far end takes whatever a line delivers: it never fails, and counts what it could not use."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.cli.messages import Decoder
from lidar_emu.runtime.port.packets import payload_of
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import BenchScenario, Wire
from lidar_emu.shots.bench_model import BenchModel
from lidar_emu.transports.frames import Frame, unpack_frames
from lidar_emu.wire import Encoder

FD_LENGTHS = [*range(9), 12, 16, 20, 24, 32, 48, 64]
SHOTS = 3


def packets(can: bool) -> list[bytes]:
    scenario = load("bench")
    assert isinstance(scenario, BenchScenario)
    model = BenchModel(scenario)
    measurement, _ = model.measure(0, SHOTS, model.initial_state)
    return [
        payload_of(packet) for packet in Encoder(Wire(), can, False, model.beam_count).packets(measurement)
    ]


PACKETS = packets(can=False)
GOOD_FRAMES = [frame for payload in packets(can=True) for frame in unpack_frames(payload)]

frames = st.builds(
    Frame,
    can_id=st.sampled_from([frame.can_id for frame in GOOD_FRAMES]) | st.integers(0, 0x7FF),
    data=st.sampled_from(FD_LENGTHS).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    is_fd=st.booleans(),
)


@settings(max_examples=200, deadline=None)
@given(pieces=st.lists(st.binary(max_size=300), max_size=6))
def test_noise_on_a_serial_line_is_counted(pieces: list[bytes]) -> None:
    decoder = Decoder()
    decoded = [message for piece in pieces for message in decoder.decode(piece)]
    noise = b"".join(pieces)
    counted = decoder.counters()
    assert decoded == []
    assert decoder.messages == 0
    # Bytes since the last delimiter may still become a packet; zeros alone delimit nothing.
    ended = [part for part in noise.split(b"\0")[:-1] if part]
    assert (sum(counted.values()) > 0) == bool(ended)


@settings(max_examples=100, deadline=None)
@given(noise=st.binary(max_size=200), after=st.integers(0, SHOTS - 1), cut=st.integers(1, 40))
def test_packets_around_noise_arrive(noise: bytes, after: int, cut: int) -> None:
    decoder = Decoder()
    line = b"".join(PACKETS[: after + 1]) + noise + b"\0" + b"".join(PACKETS[after + 1 :])
    shots = [
        message.shot
        for start in range(0, len(line), cut)
        for message in decoder.decode(line[start : start + cut])
    ]
    assert shots == list(range(SHOTS))


@settings(max_examples=200, deadline=None)
@given(noise=st.lists(frames, max_size=20))
def test_noise_on_a_bus_is_counted(noise: list[Frame]) -> None:
    decoder = Decoder()
    decoder.decode(noise)
    counted = decoder.counters()
    if noise:
        assert counted["frames"] == len(noise)


@settings(max_examples=100, deadline=None)
@given(noise=st.lists(frames, max_size=20))
def test_a_bus_recovers_from_noise(noise: list[Frame]) -> None:
    decoder = Decoder()
    decoder.decode(noise)
    # One set may be spoilt by frames that look like the beginning of it.
    shots = [message.shot for message in decoder.decode([*GOOD_FRAMES, *GOOD_FRAMES])]
    assert set(shots) == set(range(SHOTS))

"""A recording in the hands of the mcap library: whole, and cut short."""

from __future__ import annotations

import io
import json
import os
import signal
import struct
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import handwritten
import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from programs import Program
from waiting import eventually

from lidar_emu.measurement import Measurement

OF_SHOTS = {"/truth", "/measurement", "/packet", "/delivery"}
BYTES = {"/packet", "/housekeeping"}
PAGE = Path(__file__).resolve().parents[2] / "docs" / "recordings.md"
MAGIC_BYTES = 8
MESSAGE = 0x05
SHOT = b'"range_m":['

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]


@pytest.fixture
def recording(start: Start, tmp_path: Path) -> bytes:
    start("run", "descent.yaml", "--pace", "max", "--record", "r.mcap").succeed()
    return (tmp_path / "r.mcap").read_bytes()


def message_ends(data: bytes) -> list[int]:
    """Where each message record ends, by the layout of MCAP: opcode, 64-bit length, content."""
    ends, place = [], MAGIC_BYTES
    while place < len(data) - MAGIC_BYTES:
        opcode, length = struct.unpack_from("<BQ", data, place)
        place += 9 + length
        if opcode == MESSAGE:
            ends.append(place)
    return ends


@pytest.mark.slow
def test_a_whole_recording_holds_every_shot(recording: bytes, simulated: Simulated) -> None:
    expected = simulated("descent.yaml")
    by_topic: dict[str, list[Any]] = defaultdict(list)
    log_ns: dict[str, list[int]] = defaultdict(list)
    for _, channel, message in make_reader(io.BytesIO(recording)).iter_messages():
        by_topic[channel.topic].append(message.data if channel.topic in BYTES else json.loads(message.data))
        log_ns[channel.topic].append(message.log_time)
    assert set(by_topic) == OF_SHOTS | {"/housekeeping"}
    for topic in OF_SHOTS - BYTES:
        shots = [np.atleast_1d(message["shot"])[0] for message in by_topic[topic]]
        assert shots == expected.shot.tolist(), topic
    epoch_ns = 1_893_456_000 * 10**9  # 2030-01-01, the default of timing.epoch
    np.testing.assert_array_equal(np.array(log_ns["/truth"]) - epoch_ns, expected.time_ns[:, 0])
    np.testing.assert_array_equal(np.array(log_ns["/packet"]) - epoch_ns, expected.due_ns)
    for name in ("range_m", "snr_db", "closing_speed_mps"):
        values = [message[name] for message in by_topic["/measurement"]]
        np.testing.assert_array_equal(np.array(values, dtype=np.float64), getattr(expected, name), name)
    true_m = [message["true_range_m"] for message in by_topic["/truth"]]
    np.testing.assert_array_equal(np.array(true_m, dtype=np.float64), expected.true_range_m)
    headers = [handwritten.decoded(handwritten.unstuffed(data)[0])[0] for data in by_topic["/packet"]]
    assert [header["shot"] for header in headers] == expected.shot.tolist()
    assert {message["status"] for message in by_topic["/delivery"]} == {"sent"}
    (metadata,) = make_reader(io.BytesIO(recording)).iter_metadata()
    assert metadata.name == "run"
    assert json.loads(metadata.metadata["scenario"])["name"] == "descent"


@pytest.mark.parametrize("share", [0.1, 0.7, 0.999])
def test_a_cut_recording_holds_everything_before_the_cut(recording: bytes, share: float) -> None:
    messages_to = message_ends(recording)[-1]
    cut = int(share * messages_to)
    whole = [
        (channel.topic, message.sequence, message.data)
        for _, channel, message in NonSeekingReader(io.BytesIO(recording)).iter_messages(log_time_order=False)
    ]
    assert sum(topic in OF_SHOTS for topic, _, _ in whole) == 4 * 1008
    read = []
    reader = NonSeekingReader(io.BytesIO(recording[:cut]))
    try:
        for _, channel, message in reader.iter_messages(log_time_order=False):
            read.append((channel.topic, message.sequence, message.data))
    except (McapError, struct.error):
        pass  # the end of the file inside a record; the reader reports it in either way
    count = sum(end <= cut for end in message_ends(recording))
    assert count > 0.05 * len(whole)
    assert read == whole[:count]


def test_a_recording_that_was_cut_by_kill_9_opens_as_its_page_reports(
    start: Start, simulated: Simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = tmp_path / "flight.mcap"
    run = start("run", "descent.yaml", "--record", "flight.mcap")
    eventually(lambda: flight.exists() and flight.read_bytes().count(SHOT) > 20)
    run.process.kill()
    run.wait()
    with pytest.raises(McapError), flight.open("rb") as stream:
        list(make_reader(stream).iter_messages())
    (snippet,) = (code for code in PAGE.read_text().split("```") if "NonSeekingReader" in code)
    monkeypatch.chdir(tmp_path)
    reported: dict[str, Any] = {}
    exec(snippet.removeprefix("python\n"), reported)
    shots = [message["shot"][0] for message in reported["messages"]]
    assert len(shots) > 20
    expected = simulated("descent.yaml")
    assert shots == expected.shot[: len(shots)].tolist()
    ranges_m = np.array([message["range_m"] for message in reported["messages"]], dtype=np.float64)
    np.testing.assert_array_equal(ranges_m, expected.range_m[: len(shots)])


def test_a_recording_of_a_run_that_died_is_whole(start: Start, tmp_path: Path) -> None:
    run = start("run", "descent.yaml", "--record", "r.mcap")
    port = run.port_process()
    eventually(lambda: (tmp_path / "r.mcap").exists() and SHOT in (tmp_path / "r.mcap").read_bytes())
    os.kill(port, signal.SIGKILL)
    assert run.wait() == 1
    with (tmp_path / "r.mcap").open("rb") as stream:
        topics = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
    assert "/measurement" in topics

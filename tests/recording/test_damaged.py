"""Recordings with flipped, missing and foreign bytes: what is whole is read, the rest is counted, nothing is raised."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from lidar_emu.cli import cli
from lidar_emu.errors import InputError
from lidar_emu.recording.mcap_file import MAGIC
from lidar_emu.recording.read import Recording, read_recording
from lidar_emu.recording.recompute import recompute
from lidar_emu.recording.traffic import read_traffic
from lidar_emu.recording.write import interface_text
from lidar_emu.report.recorded_run import read_recorded_run

FAULTS = "[{kind: dropout, beams: [2], from_s: 0.5}, {kind: lost, at_s: 0.4}]"


@pytest.fixture(scope="module")
def flight(record: Any) -> Recording:
    recording: Recording = record("bench.yaml", duration_s="1.5", faults=FAULTS)
    return recording


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of each record, by hand from the specification of MCAP."""
    position = len(MAGIC)
    while position < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, position)
        yield opcode, position, position + 9 + length
        position += 9 + length


MESSAGE = 5


@pytest.mark.parametrize("what", ["length", "opcode", "text", "gone"])
def test_a_damaged_message_costs_its_own_shot(flight: Recording, what: str, tmp_path: Path) -> None:
    data = flight.path.read_bytes()
    messages = [(start, end) for opcode, start, end in records(data) if opcode == MESSAGE]
    start, end = next(
        (start, end)
        for start, end in messages[40:]
        if b'"range_m"' in data[start:end] and b'"fired"' in data[start:end]
    )
    shot = struct.unpack_from("<I", data, start + 11)[0]
    broken = {
        "length": data[: start + 1] + struct.pack("<Q", end - start + 900) + data[start + 9 :],
        "opcode": data[:start] + b"\xf5" + data[start + 1 :],
        "text": data[: end - 9] + b"\xff" + data[end - 8 :],
        "gone": data[:start] + data[end - 50 :],
    }[what]
    path = tmp_path / "broken.mcap"
    path.write_bytes(broken)
    damaged, whole = read_recording(path), flight.measurement()
    read = damaged.measurement()
    assert set(whole.shot.tolist()) - set(read.shot.tolist()) == {shot}
    kept = whole.shot != shot
    np.testing.assert_array_equal(read.range_m, whole.range_m[kept])
    np.testing.assert_array_equal(read.true_range_m, whole.true_range_m[kept])
    assert damaged.packets().payload == flight.packets().payload
    assert damaged.is_whole
    assert damaged.damage
    summary = read_recorded_run(damaged).contents()
    assert summary["measured"] == len(whole) - 1
    assert summary["damage"]["places"] + sum(summary["damage"]["unreadable"].values()) >= 1


def test_a_truth_that_is_lost_is_not_replaced_by_another_shot_s(flight: Recording, tmp_path: Path) -> None:
    data = flight.path.read_bytes()
    truths = [
        (start, end)
        for opcode, start, end in records(data)
        if opcode == MESSAGE and b'"true_range_m"' in data[start:end]
    ]
    start, end = truths[7]
    path = tmp_path / "broken.mcap"
    path.write_bytes(data[:start] + data[end:])
    read = read_recording(path).measurement()
    assert read.shot.tolist() == [shot for shot in range(len(truths)) if shot != 7]


def test_a_packet_that_is_lost_is_not_replayed_and_not_compared(flight: Recording, tmp_path: Path) -> None:
    data, payloads = flight.path.read_bytes(), flight.packets().payload
    start, end = next(
        (start, end)
        for opcode, start, end in records(data)
        if opcode == MESSAGE and data[start:end].endswith(payloads[9])
    )
    path = tmp_path / "broken.mcap"
    path.write_bytes(data[:start] + data[end:])
    packets = [payload for _, payload in read_traffic(path).packets]
    assert payloads[9] not in packets
    assert payloads[8] in packets
    assert payloads[10] in packets
    result = recompute(read_recording(path))
    assert (result.different, result.not_compared) == (0, 1)


@pytest.mark.parametrize(
    ("right", "wrong"), [(b'"due_ns":', b'"due_ns":1000000000000'), (b'"status":"sent"', b'"status":"gone"')]
)
def test_a_delivery_that_says_nonsense_is_left_out(
    flight: Recording, right: bytes, wrong: bytes, tmp_path: Path
) -> None:
    data = flight.path.read_bytes()
    start, end = [
        (start, end)
        for opcode, start, end in records(data)
        if opcode == MESSAGE and b'"overtaken"' in data[start:end]
    ][-3]
    content = data[start + 9 : end].replace(right, wrong)
    path = tmp_path / "broken.mcap"
    path.write_bytes(data[: start + 1] + struct.pack("<Q", len(content)) + content + data[end:])
    read = read_recording(path)
    assert len(read.packets()) == len(flight.packets()) - 1
    assert read.damage.to_json()["unreadable"] == {"/delivery": 1}


@st.composite
def damages(draw: st.DrawFn) -> list[tuple[str, float, float]]:
    """What happens to the bytes, at shares of the file."""
    kinds = st.sampled_from(["flip", "cut", "delete", "double", "zero", "noise"])
    share = st.floats(0, 1, exclude_max=True)
    return draw(st.lists(st.tuples(kinds, share, share.map(lambda x: x**4)), min_size=1, max_size=4))


def damaged(data: bytes, kind: str, place: float, size: float) -> bytes:
    start = int(place * len(data))
    end = min(len(data), start + 1 + int(size * len(data)))
    match kind:
        case "flip":
            return data[:start] + bytes([data[start] ^ 1 << int(size * 8)]) + data[start + 1 :]
        case "cut":
            return data[: max(1, start)]
        case "delete":
            return data[:start] + data[end:]
        case "double":
            return data[:end] + data[start:]
        case "zero":
            return data[:start] + bytes(end - start) + data[end:]
    return data[:start] + bytes(k * 37 % 256 for k in range(end - start)) + data[end:]


def readings(path: Path) -> Iterator[Any]:
    yield lambda: read_recorded_run(read_recording(path)).contents()
    yield lambda: read_traffic(path)
    yield lambda: recompute(read_recording(path))


@settings(max_examples=60)
@given(damages())
def test_whatever_happens_to_the_bytes_is_counted_or_refused(
    flight: Recording, tmp_path_factory: pytest.TempPathFactory, happening: list[tuple[str, float, float]]
) -> None:
    data = flight.path.read_bytes()
    for each in happening:
        data = damaged(data, *each) or b"\0"
    path = tmp_path_factory.mktemp("damaged") / "r.mcap"
    path.write_bytes(data)
    for read in readings(path):
        with suppress(InputError):
            read()


def test_commands_go_on_with_what_there_is_and_say_so(flight: Recording, tmp_path: Path) -> None:
    data = flight.path.read_bytes()
    path = tmp_path / "broken.mcap"
    path.write_bytes(data[: len(data) // 2] + data[len(data) // 2 + 700 :])
    reported = CliRunner().invoke(cli, ["report", str(path), "--json"])
    assert reported.exit_code == 0
    assert json.loads(reported.stdout)["damage"]["skipped_bytes"] > 0
    exported = CliRunner().invoke(cli, ["replay", str(path), "--to", str(tmp_path / "out.pcap")])
    assert exported.exit_code == 0
    assert flight.packets().payload[0] in (tmp_path / "out.pcap").read_bytes()


def restated(source: Path, target: Path, key: str, text: str) -> Path:
    """A copy of a recording with another value in its metadata."""
    with source.open("rb") as old, target.open("wb") as new:
        reader, writer, numbers = make_reader(old), Writer(new), dict[str, int]()
        writer.start(profile="", library=reader.get_header().library)
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata | {key: text})
        for schema, channel, message in reader.iter_messages():
            if channel.topic not in numbers:
                form = schema and writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, form or 0
                )
            at_ns = message.log_time
            writer.add_message(numbers[channel.topic], at_ns, message.data, at_ns, message.sequence)
        writer.finish()
    return target


@pytest.mark.parametrize("key", ["scenario", "build", "files_sha256", "port_options"])
@pytest.mark.parametrize("text", ["[" * 100_000, "1e400", "9" * 10_000])
def test_metadata_of_another_form_are_refused_by_their_key(
    flight: Recording, key: str, text: str, tmp_path: Path
) -> None:
    bad = restated(flight.path, tmp_path / "bad.mcap", key, text)
    command = (
        ["replay", str(bad), "--to", str(tmp_path / "out.pcap")]
        if key == "port_options"
        else ["replay", str(bad), "--recompute"]
    )
    ended = CliRunner().invoke(cli, command)
    assert isinstance(ended.exception, InputError)
    assert str(ended.exception).startswith(f"{bad}: {key}: ")


def test_an_interface_that_has_become_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    """A recording of somebody else may name any path."""
    pipe = tmp_path / "mine.toml"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="a pipe to which nobody writes"):
        interface_text(str(pipe))

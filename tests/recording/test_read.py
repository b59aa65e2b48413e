"""A recording read back, beside the simulation, the wire and the schemas that stand in the file."""

from __future__ import annotations

import hashlib
import json
import platform
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

import lidar_emu
from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.recording import channels
from lidar_emu.recording.read import Recording, read_recording
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_protocol import Housekeeping, Message, SerialReceiver

DOCS = Path(__file__).resolve().parents[2] / "docs" / "recordings.md"
FAULTS = "[{kind: dropout, beams: [2], from_s: 1, to_s: 2}, {kind: lost, at_s: 3}]"


@pytest.fixture(scope="module")
def flight(record: Any) -> Recording:
    recording: Recording = record("descent.yaml", duration_s="8", faults=FAULTS)
    return recording


@pytest.mark.slow
def test_the_measurement_is_that_of_the_simulation(flight: Recording) -> None:
    expected = lidar_emu.simulate(flight.scenario)
    read = flight.measurement()
    assert flight.is_whole
    for field in fields(Measurement):
        values = getattr(read, field.name)
        np.testing.assert_array_equal(values, getattr(expected, field.name), field.name)
        assert values.dtype == getattr(expected, field.name).dtype, field.name


def test_packets_are_what_a_receiver_decodes(flight: Recording) -> None:
    packets = flight.packets()
    assert len(packets) == 160
    suppressed = packets.status == DeliveryStatus.SUPPRESSED
    assert packets.shot[suppressed].tolist() == [60]
    assert packets.payload[60] == b""
    assert np.array_equal(packets.sent_ns >= 0, packets.status == DeliveryStatus.SENT)
    receiver = SerialReceiver(flight.interface)
    shots = [m.shot for m in receiver.receive(b"".join(packets.payload)) if isinstance(m, Message)]
    assert shots == packets.shot[~suppressed].tolist()
    np.testing.assert_array_equal(packets.due_ns, flight.measurement().due_ns)


def test_what_the_device_reported_and_what_went_wrong(flight: Recording) -> None:
    stated = flight.raw_messages(channels.HOUSEKEEPING)
    receiver = SerialReceiver(flight.interface)
    reported = [
        m for m in receiver.receive(b"".join(payload for _, payload in stated)) if isinstance(m, Housekeeping)
    ]
    step_ns = 1e9 / 2**24  # of the wire's time code
    times_ns = [time_ns for time_ns, _ in stated]
    np.testing.assert_allclose([m.values["time_ns"] for m in reported], times_ns, rtol=0, atol=step_ns)
    assert all(round((b.time_ns - a.time_ns) / 1e9) == 1 for a, b in pairwise(stated))
    faults = flight.json_messages(channels.FAULT)
    assert [each.values["shot"] for each in faults] == [*range(20, 40), 60]
    assert {each.values["kind"] for each in faults} == {"dropout", "lost"}


def test_the_origin_can_be_checked_by_other_means(flight: Recording) -> None:
    origin = flight.origin
    for name in ("scenario", "interface"):
        assert hashlib.sha256(origin[name].encode()).hexdigest() == origin[f"{name}_sha256"]
    assert "[interface]" in origin["interface"]
    assert flight.scenario.name == "descent"
    (file,) = json.loads(origin["files_sha256"]).items()
    assert Path(file[0]).name.endswith(".npz")
    assert hashlib.sha256(Path(file[0]).read_bytes()).hexdigest() == file[1]
    build = json.loads(origin["build"])
    assert build["numpy"] == np.__version__
    assert build["processor"].startswith(platform.machine())


@pytest.mark.slow
def test_every_message_is_what_its_schema_reports(flight: Recording) -> None:
    """The schemas allow nothing but what they name."""
    checked = set()
    with flight.path.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages():
            if schema is not None:
                jsonschema.validate(json.loads(message.data), json.loads(schema.data))
                checked.add(channel.topic)
        summary = reader.get_summary()
    assert checked == {"/truth", "/measurement", "/delivery", "/fault"}
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} == {c.topic for c in channels.CHANNELS}
    assert all(channel.metadata["holds"] for channel in summary.channels.values())


def test_a_column_that_a_schema_lacks_is_refused_by_it() -> None:
    schema = channels.DELIVERY.schema()
    delivery = {"shot": 0, "due_ns": 1, "sent_ns": None, "status": "late", "overtaken": False}
    jsonschema.validate(delivery, schema)
    for wrong in (delivery | {"more": 1}, delivery | {"sent_ns": "never"}, {"shot": 0}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, schema)


def _foreign(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_channel("/chatter", "json", 0)
        writer.add_message(number, 0, b"{}", 0)
        writer.finish()


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "empty"),
        (b"not a recording at all", "not MCAP"),
        (b"\x89MCAP0\r\n", "not a recording"),
        (b"\x89MCAP0\r\n" + 64 * b"\xff", "not a recording"),
        (None, "not a recording"),
    ],
)
def test_what_is_no_recording_is_refused(content: bytes | None, found: str, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    if content is None:
        _foreign(path)
    else:
        path.write_bytes(content)
    with pytest.raises(InputError, match=found) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "must be a recording" in str(refusal.value)


def test_a_missing_recording_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "nowhere.mcap", tmp_path):
        with pytest.raises(InputError, match="must be a recording"):
            read_recording(path)


def test_the_page_names_every_topic() -> None:
    text = DOCS.read_text()
    for channel in channels.CHANNELS:
        assert f"`{channel.topic}`" in text, channel.topic

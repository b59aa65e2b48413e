"""OpenC3 COSMOS reads every value of a flight with the generated plugin, and the device accepts its commands."""

from __future__ import annotations

from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import any_interface
import cosmos
import pytest
from click.testing import CliRunner
from comparison import CODES, FLAGS, SERIAL_STEPS, assert_equal
from conformance import row_of
from free_ports import free_tcp_port
from hostile_texts import with_texts
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from waiting import LIMIT_S

from lidar_emu import Measurement
from lidar_emu.cli.documents import icd
from lidar_emu.testing import StartEmulator
from lidar_icd.example import BEAMS, HEADER, shot, values
from lidar_protocol import (
    Command,
    CommandReader,
    Device,
    Message,
    SerialReceiver,
    commands,
    default_interface,
    load,
    shipped_interface,
)
from lidar_protocol.definitions import Interface
from lidar_protocol.errors import EncodeError

pytestmark = pytest.mark.slow
DRAWN = settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
NAMES = pytest.mark.parametrize("name", ["default", "altimeter"])


def frames_of(interface: Interface, count: int) -> list[bytes]:
    """Frames of consecutive shots."""
    header, beams = shot(interface)
    return [Device(interface).serial_bytes({**header, "shot": k, "time_s": k}, beams) for k in range(count)]


def messages_of(interface: Interface, data: bytes) -> list[dict[str, Any]]:
    """Values of the shots that our receiver finds in bytes."""
    found = [each for each in SerialReceiver(interface).receive(data) if isinstance(each, Message)]
    rows = [row_of(message.unit, message.header, message.beams) for message in found]
    return [{key: row[key] for key in row.keys() - {"unit"}} for row in rows]


@NAMES
def test_a_flight_and_commands_over_tcp(
    name: str, lidar_emulator: StartEmulator, simulated: Measurement, tmp_path: Path
) -> None:
    port, interface = free_tcp_port(), shipped_interface(name)
    lidar = lidar_emulator("descent.yaml", f"tcp:{port}", settings={"wire.interface": name})
    written = CliRunner().invoke(icd, ["descent.yaml", "--interface", name, "--out", str(tmp_path)])
    assert written.exit_code == 0, written.output
    plugin = cosmos.Cosmos(tmp_path / "cosmos", lidar_host="127.0.0.1", lidar_port=port)
    assert not plugin.warnings
    line = plugin.interface()
    line.connect()
    rows = []
    while len(rows) < 100:
        row = plugin.row(line.read())
        rows += [row] if row["packet"] == "MEASUREMENT" else []
    sent = b"".join(each.packet for each in lidar.wait_for_shots(100, LIMIT_S)[:100])
    ours = messages_of(interface, sent)
    assert [{key: row[key] for key in ours[0]} for row in rows] == ours
    if name == "default":
        of_beam = (*FLAGS, *CODES, *SERIAL_STEPS)
        beams = [{"shot": row["shot"], "beam": k} | {own: row[f"{own}_{k}"] for own in of_beam}
                 for row in rows for k in range(4)]  # fmt: skip
        assert_equal(beams, simulated)
    (protocol,) = line.write_protocols
    protocol.number = 7  # after commands to an earlier run
    for command, arguments in (
        ("no_op", {}),
        ("set_rate_hz", {"rate_hz": 10}),
        ("set_mode", {"mode": "standby"}),
    ):
        line.write(plugin.command(command, **arguments))
        answers = (plugin.row(packet) for packet in iter(line.read, None))
        answer = next(row for row in answers if row["packet"] == "ACKNOWLEDGE")
        assert answer["verdict"] == interface.enumerations["verdict"]["accepted"]
    line.disconnect()


@NAMES
def test_a_packet_does_not_wait_for_the_next_one(name: str, tmp_path: Path) -> None:
    """Between the delimiters of two frames is no packet, which would end a read."""
    interface = shipped_interface(name)
    frames = frames_of(interface, 3)
    line = cosmos.plugin(interface, tmp_path).interface(frames)
    for taken in (1, 2, 3):
        assert line.read().buffer
        assert line.stream.taken == taken
    assert line.read() is None


@DRAWN
@given(name=st.sampled_from(["default", "altimeter"]), drawn=st.data())
def test_damaged_and_divided_frames(
    name: str, drawn: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """COSMOS has the shots that our receiver has, and none that was not sent.

    Its COBS takes a last run that states more bytes than there are, so that it may have more shots than our receiver.
    """
    interface = shipped_interface(name)
    whole = b"".join(frames_of(interface, 5))
    starts = st.sampled_from(range(0, len(whole), len(whole) // 5))
    data, places = bytearray(whole), st.integers(0, len(whole) - 1) | starts
    for place in drawn.draw(st.lists(places, max_size=4)):
        data[place] ^= 1 << drawn.draw(st.integers(0, 7))
    for place in drawn.draw(st.lists(places, max_size=2)):
        data[place:place] = drawn.draw(st.binary(max_size=20) | st.sampled_from([b"\0", b"\x1a\xcf\xfc\x1d"]))
    cuts = [0, *sorted(drawn.draw(st.lists(st.integers(1, len(data)), max_size=6))), len(data)]
    portions = [bytes(data[start:end]) for start, end in pairwise(cuts) if end > start]
    plugin = cosmos.plugin(interface, tmp_path_factory.mktemp("damaged"), beams=5)
    sent, ours = messages_of(interface, whole), messages_of(interface, bytes(data))
    read = [{key: row[key] for key in sent[0]} for row in map(plugin.row, plugin.packets(portions))]
    assert [row for row in read if row in ours] == ours
    assert all(row in sent for row in read)


@DRAWN
@given(tree=any_interface.trees(), drawn=st.data())
def test_commands_of_any_interface(
    tree: dict[str, Any], drawn: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Each is what our encoder sends, numbered, and the device reads it."""
    interface = load(any_interface.document(tree), "drawn.toml")
    unit = drawn.draw(st.integers(0, interface.units - 1))
    plugin = cosmos.plugin(interface, tmp_path_factory.mktemp("commands"), unit)
    assert not plugin.warnings
    fields = tree["commands"]["second"]["fields"]
    given_values, _ = drawn.draw(any_interface.values(fields))
    for field in fields:
        if "wraps" in field:
            given_values[field["name"]] %= 1 << any_interface.bits_of(field)
    assume(None not in given_values.values())
    line = plugin.interface([])
    try:
        expected = [
            commands.encode(interface, unit, "first", {"sequence": 0}),
            commands.encode(interface, unit, "second", {"sequence": 1, **given_values}),
        ]
    except EncodeError:
        assume(False)
    constants = {field["name"] for field in fields if "constant" in field}
    line.write(plugin.command("first"))
    line.write(
        plugin.command(
            "second", **{name: value for name, value in given_values.items() if name not in constants}
        )
    )
    assert line.stream.written == b"".join(expected)
    read = CommandReader(interface, unit).feed(line.stream.written)
    assert [(each.name, each.sequence) for each in read if isinstance(each, Command)] == [
        ("first", 0),
        ("second", 1),
    ]


def test_commands_are_numbered_again_from_0(tmp_path: Path) -> None:
    plugin = cosmos.plugin(default_interface(), tmp_path, unit=5)
    line, reader = plugin.interface([]), CommandReader(default_interface(), 5)
    for _ in range(258):
        line.write(plugin.command("no_op"))
    assert [each.sequence for each in reader.feed(line.stream.written)] == [*range(256), 0, 1]


def test_arguments_are_sent_as_the_nearest_step(tmp_path: Path) -> None:
    assert 1.001 * 1000 < 1001
    plugin = cosmos.plugin(default_interface(), tmp_path)
    line = plugin.interface([])
    line.write(plugin.command("set_rate_hz", rate_hz=1.001))
    (read,) = CommandReader(default_interface()).feed(line.stream.written)
    assert isinstance(read, Command)
    assert read.values == {"rate_hz": 1.001}


def test_arguments_out_of_range_are_refused(tmp_path: Path) -> None:
    plugin = cosmos.plugin(default_interface(), tmp_path)
    for name, arguments in (
        ("set_rate_hz", {"rate_hz": 1e5}),
        ("set_mode", {"mode": "sleep"}),
        ("set_mode", {}),
    ):
        with pytest.raises((ValueError, RuntimeError)):
            plugin.command(name, **arguments)


@NAMES
def test_housekeeping_and_acknowledgements(name: str, tmp_path: Path) -> None:
    interface, unit = shipped_interface(name), 3
    plugin, device = cosmos.plugin(interface, tmp_path, unit), Device(interface, unit)
    assert interface.housekeeping is not None
    stated = {**values(interface.housekeeping), "mode": "track", "temperature_c": None}
    stated |= dict.fromkeys(stated.keys() & {"time_ns"}, 5 * 10**9)
    acknowledged = {"sequence": 7, "verdict": "out_of_state", "time_ns": 5 * 10**9}
    sent = device.housekeeping(2, stated) + device.acknowledge(1, "set_mode", **acknowledged)
    housekeeping, acknowledge = (plugin.row(packet) for packet in plugin.packets([sent]))
    track = next(words["track"] for words in interface.enumerations.values() if "track" in words)
    assert {key: housekeeping[key] for key in stated} == {**stated, "mode": track}
    assert acknowledge["sequence"] == 7
    assert acknowledge["verdict"] == interface.enumerations["verdict"]["out_of_state"]
    other = Device(interface, 2).housekeeping(2, stated)
    assert [plugin.row(packet) for packet in plugin.packets([other])] == [{}]


def test_a_plugin_has_the_unit_and_the_beams_of_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "my.yaml").write_text("""name: three beams
bench_pattern: {duration_s: 1, beams: [&beam {range_m: 9, closing_speed_mps: 1}, *beam, *beam]}
wire: {unit: 5}
""")
    written = CliRunner().invoke(icd, [str(tmp_path / "my.yaml"), "--out", str(tmp_path)])
    assert written.exit_code == 0, written.output
    plugin = cosmos.Cosmos(tmp_path / "cosmos")
    (row,) = map(plugin.row, plugin.packets([Device(default_interface(), 5).serial_bytes(HEADER, BEAMS[:3])]))
    assert (row["beam_count"], row["range_m_1"], row["range_m_2"]) == (3, BEAMS[1]["range_m"], None)
    assert "RANGE_M_3" not in plugin.telemetry.packet(cosmos.TARGET, "MEASUREMENT").items


@pytest.mark.parametrize(
    "hostile", ['"]]>& <%= exit %> \\', "' # \u0007 \u00e4\u2028\n TELEMETRY X Y", "ends in +", ""]
)
def test_texts_cannot_leave_their_lines(hostile: str, tmp_path: Path) -> None:
    plugin = cosmos.plugin(with_texts(hostile), tmp_path)
    (row,) = map(plugin.row, plugin.packets([Device(default_interface()).serial_bytes(HEADER, BEAMS)]))
    assert (row["shot"], row["range_m_0"]) == (HEADER["shot"], BEAMS[0]["range_m"])
    texts = [path.read_text(encoding="utf-8") for path in (tmp_path / "targets").rglob("*.txt")]
    assert not any("<%" in text for text in texts)


def test_names_that_cosmos_does_not_allow_and_spare_bytes_at_the_end(tmp_path: Path) -> None:
    given_names = ["received_count", "two__underscores", "two_underscores", "ends_", "ends"]
    fields = "".join(f'[[housekeeping]]\nname = "{name}"\ntype = "u8"\n' for name in given_names)
    text = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
    interface = load(
        text.replace("[[acknowledge]]", f"{fields}[[housekeeping]]\nspare = 16\n[[acknowledge]]", 1),
        "names.toml",
    )
    plugin = cosmos.plugin(interface, tmp_path)
    stated = values(interface.housekeeping) | {name: k for k, name in enumerate(given_names)}
    (row,) = map(plugin.row, plugin.packets([Device(interface).housekeeping(0, stated)]))
    shown = ["received_count_2", "two_underscores", "two_underscores_2", "ends", "ends_2"]
    assert [row[name] for name in shown] == [0, 1, 2, 3, 4]

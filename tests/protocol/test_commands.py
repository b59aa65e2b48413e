"""Commands, acknowledgements and housekeeping: whole, in pieces, with garbage around, and wrong in every way."""

import binascii
import struct

import pytest

from lidar_protocol import (
    Acknowledge,
    CanCommandReader,
    CanReceiver,
    Command,
    CommandReader,
    Device,
    EncodeError,
    Host,
    Housekeeping,
    SerialReceiver,
    cobs,
    default_interface,
    shipped_interface,
)

DEFAULT, ALTIMETER = default_interface(), shipped_interface("altimeter")
ARGUMENTS = {
    "no_op": {},
    "set_mode": {"mode": "standby"},
    "set_pattern": {"pattern": 2},
    "set_rate_hz": {"rate_hz": 12.5},
    "enable_beams": {"beams": 0b1011},
    "time_at_tone": {"tone_ns": 1_500_000_000},
    "set_parameter": {"parameter": 300, "number": -0.25},
    "reset": {"restart": "cold"},
}
HEALTH = {
    "time_ns": 2_000_000_000,
    "software_major": 1,
    "software_minor": 2,
    "software_patch": 3,
    "mode": "track",
    "interlock_closed": True,
    "laser_on": True,
    "clock_locked": False,
    "temperature_c": -12.34,
    "laser_power_w": None,
    "uptime_s": 86_400,
    "shots_dropped": 1,
    "shots_late": 2,
    "commands_accepted": 3,
    "commands_rejected": 4,
    "bad_bytes": 5,
    "truth_age_s": 0.00025,
}


def numbers(interface, name):
    """The arguments of a command as they arrive."""
    words = {"standby": interface.enumerations.get("mode", {}).get("standby"), "cold": 1}
    return {key: words.get(value, value) for key, value in ARGUMENTS[name].items()}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_each_command_arrives_with_its_arguments(name):
    sent = Host(DEFAULT, 3).encode_command(name, sequence=77, **ARGUMENTS[name])
    assert CommandReader(DEFAULT, 3).feed(sent) == [Command(3, name, 77, numbers(DEFAULT, name))]
    frame = Host(DEFAULT, 3).encode_command_frame(name, sequence=77, **ARGUMENTS[name])
    assert (frame.is_fd, len(frame.data) <= 8) == (False, True)
    assert CanCommandReader(DEFAULT, 3).feed(frame.can_id, frame.data, is_fd=True) == []
    assert CanCommandReader(DEFAULT, 3).feed(frame.can_id, frame.data) == [
        Command(3, name, 77, numbers(DEFAULT, name))
    ]


def test_a_command_by_hand():
    """A telecommand packet without secondary header, as in INTERFACE.md, with `struct` alone."""
    head = struct.pack(">HHHBBI", 0x1000 | 0x2A1, 0xC000 | 9, 8 - 1, 3, 9, 12_500)
    plain = head + struct.pack(">H", binascii.crc_hqx(head, 0xFFFF))
    assert (
        Host(DEFAULT, 1).encode_command("set_rate_hz", sequence=9, rate_hz=12.5)
        == b"\0" + cobs.encode(plain) + b"\0"
    )


def test_damage_other_units_and_telemetry_are_counted_and_nothing_else():
    reader = CommandReader(DEFAULT, 2)
    good = Host(DEFAULT, 2).encode_command("no_op", sequence=1)
    plain = bytearray(cobs.decode(good.strip(b"\0")))
    plain[-1] ^= 1
    shot_like = Device(DEFAULT, 2).acknowledge(0, "no_op", time_ns=0, sequence=1, verdict="accepted")
    for data in (
        cobs.encode(bytes(plain)) + b"\0",
        Host(DEFAULT, 3).encode_command("no_op", sequence=1),
        shot_like,
        b"\x09\x01\x01\0",
        cobs.encode(bytes(plain[:-1])) + b"\0",
        b"\x01" * 5000 + b"\0",
    ):
        assert reader.feed(data) == []
    counters = reader.counters
    found = (counters.bad_crc, counters.foreign, counters.bad_stuffing, counters.bad_length)
    assert found == (1, 2, 1, 2)
    assert reader.feed(good) != []
    assert reader.buffered_bytes == 0


@pytest.mark.parametrize(
    ("name", "values", "complaint"),
    [
        ("fly", {}, "command fly: the interface has"),
        ("set_patern", {}, "did you mean set_pattern"),
        ("set_mode", {}, "mode is missing"),
        ("set_mode", {"mode": "asleep"}, "'asleep' is none of off, standby"),
        ("set_mode", {"mode": 99}, "mode has no such value"),
        ("set_rate_hz", {"rate_hz": 0.0}, "rate_hz is out of range"),
        ("set_parameter", {"parameter": 1, "number": float("inf")}, "number is out of range"),
        ("no_op", {"mode": 1}, "has no mode"),
        ("set_mode", {"mode": 3.5}, "mode has to be a whole number instead of 3.5"),
        ("enable_beams", {"beams": 2.6}, "beams has to be a whole number"),
    ],
)
def test_a_host_refuses_what_a_device_would(name, values, complaint):
    for encode in (Host(DEFAULT).encode_command, Host(DEFAULT).encode_command_frame):
        with pytest.raises(EncodeError, match=complaint):
            encode(name, sequence=0, **values)
    with pytest.raises(EncodeError, match="sequence"):
        Host(DEFAULT).encode_command("no_op")
    with pytest.raises(EncodeError, match="on CAN"):
        Host(ALTIMETER).encode_command_frame("no_op", sequence=0)


@pytest.mark.parametrize("step", [1, 1000])
def test_answers_and_health_arrive_between_shots(step):
    from lidar_icd import example

    device = Device(DEFAULT, 6)
    shot = device.serial_bytes(example.HEADER, example.BEAMS)
    accepted = device.acknowledge(0, "reset", time_ns=0, sequence=8, verdict="accepted")
    unknown = device.acknowledge(1, 200, time_ns=0, sequence=9, verdict="unknown")
    stream = shot + accepted + b"\x07garbage" + unknown + device.housekeeping(0, HEALTH) + shot
    receiver = SerialReceiver(DEFAULT)
    found = [each for k in range(0, len(stream), step) for each in receiver.receive(stream[k : k + step])]
    yes, no, health = found[1:4]
    assert (type(yes), yes.unit, yes.command, yes.sequence, yes.verdict) == (
        Acknowledge,
        6,
        "reset",
        8,
        "accepted",
    )
    assert (no.command, no.sequence, no.verdict, no.values["command"]) == (None, 9, "unknown", 200)
    check_health(health.values, HEALTH)
    assert health.values["interface_version"] == DEFAULT.version
    assert (receiver.counters.messages, receiver.counters.frames) == (5, 6)


def check_health(values, expected):
    for name, value in expected.items():
        if isinstance(value, str):
            assert values[name] == DEFAULT.enumerations["mode"][value]
        else:
            assert values[name] == (
                value if value is None else pytest.approx(value, abs=1e-9 if name != "time_ns" else 30)
            )


def test_health_on_can_comes_in_parts():
    receiver, device = CanReceiver(DEFAULT), Device(DEFAULT, 6)
    parts = [each for frame in device.housekeeping_frames(HEALTH) for each in receiver.receive(*frame[:3])]
    assert {type(part) for part in parts} == {Housekeeping}
    together = {name: value for part in parts for name, value in part.values.items()}
    check_health(together, {name: value for name, value in HEALTH.items() if name != "time_ns"})
    frame = device.acknowledge_frame("no_op", sequence=3, verdict="out_of_state")
    (answer,) = receiver.receive(*frame[:3])
    assert (answer.unit, answer.command, answer.sequence, answer.verdict) == (6, "no_op", 3, "out_of_state")
    assert receiver.counters.messages == len(parts) + 1


def test_an_altimeter_reports_how_it_is():
    device = Device(ALTIMETER, 3)
    stream = device.acknowledge(0, "no_op", sequence=3, verdict="accepted")
    stream += device.housekeeping(1, {"mode": "track", "temperature_c": 200, "uptime_s": 1.5})
    answer, health = SerialReceiver(ALTIMETER).receive(stream)
    assert (answer.unit, answer.sequence, answer.verdict) == (3, 3, "accepted")
    assert health.values == {"mode": 2, "temperature_c": 127, "uptime_s": 1.5}


def test_cantools_reads_commands_answers_and_health():
    import cantools

    import lidar_icd

    database = cantools.database.load_string(lidar_icd.dbc(DEFAULT), "dbc", strict=True)
    host, device = Host(DEFAULT), Device(DEFAULT)

    def read(frame):
        message = database.get_message_by_frame_id(frame.can_id)
        assert message.encode(message.decode(frame.data)) == frame.data
        return message.decode(frame.data)

    assert read(host.encode_command_frame("set_mode", sequence=3, mode="safe")) == {
        "sequence": 3,
        "mode": "safe",
    }
    parameter = read(host.encode_command_frame("set_parameter", sequence=3, parameter=7, number=-0.25))
    assert parameter == {"sequence": 3, "parameter": 7, "number": -0.25}
    assert database.get_message_by_name("CommandReset").senders == ["HOST"]
    answer = read(device.acknowledge_frame("reset", sequence=3, verdict="bad_sequence"))
    assert answer == {"command": "reset", "sequence": 3, "verdict": "bad_sequence"}
    health = {
        name: value for frame in device.housekeeping_frames(HEALTH) for name, value in read(frame).items()
    }
    assert (health["mode"], health["laser_power_w"], health["uptime_s"]) == ("track", "none", 86_400)
    assert health["temperature_c"] == pytest.approx(-12.34)

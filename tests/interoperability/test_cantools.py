"""A logged descent, read by python-can and decoded by cantools with the DBC alone, is what was simulated."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import can
import cantools
import pytest
from cantools.database.can import Database
from comparison import CODES, FLAGS, SERIAL_HELD, assert_equal

from lidar_emu import Measurement, load
from lidar_emu.recording.captures import write_log
from lidar_emu.transports.frames import Frame, pack_frames
from lidar_emu.wire import Encoder
from lidar_icd import dbc
from lidar_protocol import load as definition

pytestmark = pytest.mark.slow
NOTHING = ("none", "absent")
HELD = {
    "full": {**SERIAL_HELD, "snr_db": (0.0, 62.0), "second_sigma_range_m": (0.0, 1.27)},
    "fd": SERIAL_HELD,
}


@pytest.fixture(scope="module", params=["full", "fd"])
def logged(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, simulated: Measurement
) -> tuple[str, Path]:
    """The set of messages, and a log in candump's format."""
    path = tmp_path_factory.mktemp("can") / "run.log"
    wire = load("descent.yaml", {"wire.can_messages": "full"}).wire
    encoder = Encoder(wire, can=True, fd=request.param == "fd", beam_count=simulated.beam_count)
    frames = ([Frame(*frame) for frame in packet] for packet in encoder.packets(simulated))
    write_log(path, ((shot * 50_000_000, pack_frames(of_shot)) for shot, of_shot in enumerate(frames)))
    return request.param, path


def beams_of(database: Database, log: Path) -> dict[tuple[int, int], dict[str, Any]]:
    """Values by shot and beam, None where the DBC names the code for no value."""
    found: dict[tuple[int, int], dict[str, Any]] = {}
    shot = -1
    for frame in can.CanutilsLogReader(log):
        message = database.get_message_by_frame_id(frame.arbitration_id)
        assert message.is_fd == frame.is_fd
        numbers = message.decode(frame.data, decode_choices=False)
        words = message.decode(frame.data)
        missing = {name for name in numbers if name not in CODES and str(words[name]) in NOTHING}
        values = numbers | dict.fromkeys(missing)
        shot = int(values.get("shot", shot))
        if of_beam := re.fullmatch(r"(Beam|Quality|Geometry|FdBeam)(\d)", message.name):
            assert values["shot_counter"] == shot % 16
            found.setdefault((shot, int(of_beam[2])), {}).update(values)
    return found


def test_a_whole_descent(documents: Path, logged: tuple[str, Path], simulated: Measurement) -> None:
    kind, path = logged
    database = cantools.database.load_file(documents / "lidar.dbc", strict=True)
    assert isinstance(database, Database)
    beams = beams_of(database, path)
    assert len(beams) == simulated.range_m.size
    beam = database.get_message_by_name("FdBeam0" if kind == "fd" else "Beam0")
    others = (
        [] if kind == "fd" else [database.get_message_by_name(name) for name in ("Quality0", "Geometry0")]
    )
    signals = [signal for message in (beam, *others) for signal in message.signals]
    steps = {each.name: float(each.scale) for each in signals if hasattr(simulated, each.name)}
    exact = [name for name in FLAGS + CODES if name in steps]
    steps = {name: step for name, step in steps.items() if name not in exact}
    assert {"range_m", "closing_speed_mps", "snr_db", "sigma_range_m", "second_range_m"} <= set(steps)
    rows = [{"shot": shot, "beam": number, **values} for (shot, number), values in beams.items()]
    assert_equal(rows, simulated, steps, HELD[kind], exact)


def test_a_quoted_word_leaves_the_database_whole() -> None:
    text = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
    quoted = text.replace("no_surface = 2", "no_surface = 2\n'the \"far\" one' = 99")
    database = cantools.database.load_string(dbc(definition(quoted, "mine.toml")), "dbc", strict=True)
    assert isinstance(database, Database)
    choices = database.get_message_by_name("Quality0").get_signal_by_name("reason").choices
    assert choices is not None
    assert choices[99] == "the 'far' one"

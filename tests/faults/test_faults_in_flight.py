"""Faults ordered in flight: what is taken, from which shot it acts, and that it can be flown again."""

from __future__ import annotations

import itertools
import json
import socket
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from waiting import LIMIT_S, eventually

import lidar_emu
from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import events_of
from lidar_emu.errors import InputError
from lidar_emu.faults.packets import faulty_encoder
from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.fault_injector import FaultInjector
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.scenario.load import read_fault, shifted
from lidar_emu.session import Block, Session
from lidar_emu.shots.model import build_model
from lidar_emu.transports.spec import PortSpec
from lidar_emu.wire import Encoder

RATE_HZ, SHOTS, PERIOD_S = 50, 100, 0.02
COMMAND = [
    sys.executable,
    "-c",
    "import sys; sys.argv[0] = 'lidar-emu'; from lidar_emu.cli import main; main()",
]


@pytest.mark.parametrize(
    ("text", "window"),
    [
        ("{kind: dropout, lasts_s: 2}", (0, 2, 0)),
        ("{kind: dropout, lasts_s: 2, from_s: 1}", (1, 3, 0)),
        ("{kind: dropout, lasts_s: 2, probability: 0.5}", (0, None, 2)),
        ("{kind: disconnect, lasts_s: 2}", (0, 2, 0)),
    ],
)
def test_how_long_it_lasts(text: str, window: tuple[float, float | None, float]) -> None:
    fault = read_fault(text)
    assert (fault.from_s, fault.to_s, fault.lasts_s) == window


def test_times_count_from_when_it_takes_effect() -> None:
    later = shifted(read_fault("{kind: dropout, from_s: 1, to_s: 3}"), 10.0)
    assert (later.from_s, later.to_s) == (11.0, 13.0)
    at = shifted(read_fault("{kind: dropout, at_s: 1}"), 10.0)
    assert (at.at_s, at.from_s) == (11.0, 0.0)  # type: ignore[union-attr]
    assert type(at).model_validate_json(at.model_dump_json()) == at


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "dropout",
            "fault: must be a mapping such as {kind: dropout, beams: [2], lasts_s: 2} (got 'dropout')",
        ),
        ("{kind: dropot}", "fault: kind: did you mean dropout? must be laser_fade, misalignment, "),
        ("{kind: dropout, beam: 2}", "fault: beam: no such key; did you mean beams? known here: "),
        ("{kind: bias, range_m: x}", "fault: range_m: must be a number (got 'x')"),
        ("{kind: dropout, lasts_s: [1]}", "fault: to_s: "),
        ("{kind: dropout, lasts_s: -1}", "fault: lasts_s: must be greater than 0 (got -1)"),
        ("{kind: dropout, lasts_s: .nan, from_s: 1}", "fault: lasts_s: must be greater than 0 (got nan)"),
        ("{kind: [", "fault"),
        ("{}", "fault: kind: missing"),
        ("\ud800".encode("utf-8", "replace").decode(), "fault"),
    ],
)
def test_what_is_no_fault_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as refused:
        read_fault(text)
    assert str(refused.value).startswith(message)


@given(text=st.text(max_size=60))
@settings(deadline=None, max_examples=100)
def test_any_text_is_a_fault_or_refused(text: str) -> None:
    with suppress(InputError):
        assert read_fault(text).kind


EACH = [
    "{kind: dropout, beams: [1], lasts_s: 0.3}",
    "{kind: bias, range_m: 2, ramp_s: 0.2}",
    "{kind: noise, range_m: 1, probability: 0.5}",
    "{kind: wrong_sign, from_s: 0.1, lasts_s: 0.2}",
    "{kind: time_jump, jump_s: 1, lasts_s: 0.2}",
    "{kind: lost, probability: 0.3, lasts_s: 0.1}",
    "{kind: doubled, at_s: 0.2}",
    "{kind: reordered, at_s: 0}",
    "{kind: bit_errors, rate: 0.001}",
    "{kind: wrong_endian, lasts_s: 0.1}",
    "{kind: delayed, delay_s: 0.05, lasts_s: 0.1}",
    "{kind: garbage, bytes: 9}",
    "{kind: brown_out, lasts_s: 0.1}",
    "{kind: brown_out, from_s: 0.2, to_s: 0.25}",
    "{kind: interlock, lasts_s: 0.2}",
]
"""All but those that repeat what was before them, of which an order in flight knows nothing."""


def sent(blocks: list[Block]) -> list[Any]:
    return [
        [packet for block in blocks for packet in block.packets],
        [due for block in blocks for due in block.due_ns],
        sorted(fault for block in blocks for fault in block.faults),
    ]


@given(
    orders=st.lists(st.tuples(st.integers(1, 30), st.sampled_from(EACH)), min_size=1, max_size=4),
    block_shots=st.integers(1, 16),
    at_the_start=st.lists(st.sampled_from(EACH), max_size=2),
)
@settings(deadline=None, max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_was_ordered_in_flight_can_be_flown_again(
    bench: Any, shoot: Any, device_constants_of: Any, orders: Any, block_shots: int, at_the_start: list[str]
) -> None:
    scenario = bench(*(json.loads(read_fault(text).model_dump_json()) for text in at_the_start))
    encoder = Encoder(scenario.wire, False, False, 4)
    model = build_model(scenario)
    faulty, constants = faulty_encoder(scenario, encoder, False), device_constants_of(scenario, model)
    session = Session(model, encoder, 10, faulty, constants)
    blocks: list[Block] = []
    for wait, text in orders:
        for count in [block_shots] * (wait // block_shots) + [wait % block_shots]:
            if (block := session.shoot(count)) is not None:
                blocks.append(block)
        fault = shifted(read_fault(text), session.next_shot * PERIOD_S)
        scenario = scenario.model_copy(update={"faults": [*scenario.faults, fault]})
        session.use_faults(
            model.with_faults(scenario.faults),
            faulty_encoder(scenario, encoder, False),
            events_of(scenario.faults),
        )
    while (block := session.shoot(block_shots)) is not None:
        blocks.append(block)
    again = type(scenario).model_validate_json(scenario.model_dump_json())
    assert sent(blocks) == sent(shoot(again))


def test_light_and_receiver_go_wrong_in_flight_too(shoot: Any) -> None:
    scenario = lidar_emu.load("descent.yaml", {"site": "flat", "duration_s": "2"})
    encoder = Encoder(scenario.wire, False, False, 4)
    session = Session(build_model(scenario), encoder)
    blocks, model = [session.shoot(13)], build_model(scenario)
    for text in (
        "{kind: laser_fade, loss_db: 8, ramp_s: 0.5}",
        "{kind: false_alarms, noise_db: 2, probability: 0.4}",
    ):
        fault = shifted(read_fault(text), session.next_shot / 20)
        scenario = scenario.model_copy(update={"faults": [*scenario.faults, fault]})
        session.use_faults(model.with_faults(scenario.faults), faulty_encoder(scenario, encoder, False))
        blocks.append(session.shoot(9))
    blocks.append(session.shoot(40))
    assert model.physics is None
    assert sent([block for block in blocks if block]) == sent(shoot(scenario))


class FaultRecorder(Observer):
    def __init__(self) -> None:
        self.faults: list[tuple[int, Any, int]] = []

    def on_fault_injected(self, number: int, fault: Any, shot: int) -> None:
        self.faults.append((number, fault, shot))


class Controlled:
    """A session, a fault injector, and a client."""

    def __init__(self, scenario: Any, path: Path, pace: Pace = Pace.WALL, room_bytes: int = 8000) -> None:
        encoder = Encoder(scenario.wire, False, False, 4)
        self.path, self.reported = path, FaultRecorder()
        model = build_model(scenario)
        self.session = Session(model, encoder, 10, faulty_encoder(scenario, encoder, False))
        self.device = DeviceTimeline(self.session.constants, initial(self.session.constants))
        self.port_faults: list[dict[str, Any]] = []
        self.injector = FaultInjector(
            str(path / "control"),
            scenario,
            model,
            encoder,
            RunOptions(PortSpec(), pace),
            (200, room_bytes),
            self.port_faults.append,
            self.device.use_events,
            [self.reported],
            Machine(),
        )
        port: Any = None
        self.changes = ChangeQueue(port, None, self.injector)

    def inject(self, text: str) -> dict[str, Any]:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
            asking.bind(str(self.path / "answer"))
            asking.sendto(text.encode(), str(self.path / "control"))
            self.changes.receive(0)
            answer: dict[str, Any] = json.loads(asking.recv(65536))
        (self.path / "answer").unlink()
        return answer

    def apply(self) -> None:
        while self.changes.first is not None:
            self.changes.apply_first(self.session, None)


def test_an_injected_fault_is_answered_applied_and_observed(bench: Any, shoot: Any, tmp_path: Path) -> None:
    scenario = bench({"kind": "lost", "at_s": 0.1})
    with (controlled := Controlled(scenario, tmp_path)).injector:
        blocks = [controlled.session.shoot(20)]
        assert controlled.inject(EACH[0]) == {"accepted": True, "fault": 1, "kind": "dropout"}
        assert controlled.inject("{kind: dropout, beams: [4]}")["reason"].endswith(
            "must be beams of the scenario, 0 to 3 (got [4])"
        )
        assert controlled.inject("{kind: babble, bytes_per_s: 10, lasts_s: 1}")["fault"] == 2
        assert controlled.port_faults == []
        blocks.append(controlled.session.shoot(5))
        controlled.apply()
        blocks += [controlled.session.shoot(SHOTS)]
    (order,) = controlled.port_faults
    assert (order["number"], order["kind"], order["from_ns"], order["to_ns"]) == (
        2,
        "babble",
        500_000_000,
        1_500_000_000,
    )
    assert [(number, fault.kind, shot) for number, fault, shot in controlled.reported.faults] == [
        (1, "dropout", 25), (2, "babble", 25),
    ]  # fmt: skip
    reported = controlled.injector.to_json()
    assert reported["refused"] == 1
    again = bench(*json.loads(json.dumps([{"kind": "lost", "at_s": 0.1}, *reported["injected"]])))
    assert sent([block for block in blocks if block]) == sent(shoot(again))


def test_a_fault_is_applied_once_there_was_time_to_build_it_again(
    bench: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read_ns = itertools.count(1_000_000_000, 5_000_000)
    monkeypatch.setattr(Clock, "now_ns", lambda _: next(read_ns))
    with (controlled := Controlled(bench(), tmp_path)).injector:
        controlled.inject(EACH[0])
        assert controlled.changes.first is not None
        assert controlled.changes.first.arrived_ns == next(read_ns) - 5_000_000 + 2 * 5_000_000


@pytest.mark.parametrize(
    ("text", "pace", "room_bytes", "message"),
    [
        ("{kind: disconnect}", Pace.MAX, 8000, "use --pace wall"),
        ("{kind: bus_off}", Pace.WALL, 8000, "bus_off on a byte link; use a CAN bus"),
        ("{kind: garbage, bytes: 900}", Pace.WALL, 1000, "packets of 1100 bytes; in flight, there is room for 1000"),
        ("{kind: laser_fade, loss_db: 3}", Pace.WALL, 8000, "use a scenario with a flight"),
    ],
)  # fmt: skip
def test_what_this_run_cannot_do_is_refused(
    bench: Any, tmp_path: Path, text: str, pace: Pace, room_bytes: int, message: str
) -> None:
    with (controlled := Controlled(bench(), tmp_path, pace, room_bytes)).injector:
        answer = controlled.inject(text)
        assert not answer["accepted"]
        assert message in answer["reason"]
        assert controlled.changes.first is None


def test_the_path_is_the_owners_and_is_given_back(bench: Any, tmp_path: Path) -> None:
    path = tmp_path / "control"
    with (controlled := Controlled(bench(), tmp_path)).injector:
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        with pytest.raises(InputError, match="--control: must be a path that does not exist yet"):
            Controlled(bench(), tmp_path)
        assert controlled.inject(EACH[0])["accepted"]
    assert not path.exists()
    path.write_text("somebody's")
    with pytest.raises(InputError, match="--control"):
        Controlled(bench(), tmp_path)
    assert path.read_text() == "somebody's"
    path.unlink()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as dead:
        dead.bind(str(path))
    with Controlled(bench(), tmp_path).injector:
        assert path.is_socket()


@pytest.mark.slow
def test_faults_are_injected_by_command(tmp_path: Path) -> None:
    run = ["run", "bench.yaml", "--duration", "20", "--control", "c", "--json"]
    running = subprocess.Popen([*COMMAND, *run], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    eventually(lambda: (tmp_path / "c").exists() or running.poll() is not None)

    def inject(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*COMMAND, "inject", "c", *words], cwd=tmp_path, capture_output=True, text=True)

    first = inject("{kind: dropout, beams: [2], lasts_s: 0.5}")
    assert (first.returncode, first.stdout) == (0, "accepted: fault 0, dropout\n")
    second = inject("kind=disconnect", "lasts_s=0.2", "--json")
    assert json.loads(second.stdout) == {"accepted": True, "fault": 1, "kind": "disconnect"}
    third = inject("kind=dropout", "beams=[7]")
    assert (third.returncode, third.stdout) == (1, "")
    assert "rejected: bench: faults.2.beams: must be beams of the scenario, 0 to " in third.stderr
    out, _ = running.communicate(timeout=LIMIT_S)
    summary = json.loads(out.splitlines()[-1])
    assert running.returncode == 0
    dropout, disconnect = summary["faults_in_flight"]["injected"]
    # A fault taken before the first shot is built begins at 0, the default, which a summary leaves out.
    assert dropout["to_s"] - dropout.get("from_s", 0.0) == pytest.approx(0.5)
    assert disconnect["to_s"] - disconnect.get("from_s", 0.0) == pytest.approx(0.2)
    assert summary["faults_in_flight"]["refused"] == 1
    assert summary["faults"]["shots"] == {"disconnect": 2, "dropout": 5}
    events = [event["what"] for event in summary["link_events"]]
    assert events == ["link broken: disconnected by an injected fault", "reopened"]
    assert not (tmp_path / "c").exists()
    nobody = inject("kind=lost")
    assert nobody.returncode == 2
    assert "name the path of a run's --control" in nobody.stderr

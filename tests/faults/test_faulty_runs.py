"""Faulty runs replay: bytes depend on scenario and seed alone, and shots that no fault concerns are as without it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from ruamel.yaml import YAML

import lidar_emu
from lidar_emu.api import simulate
from lidar_emu.cli import cli
from lidar_emu.faults.packets import faulty_encoder
from lidar_emu.runtime.fault_injector import port_faults
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.scenario.faults import (
    BeamFault,
    ContentFault,
    DeviceFault,
    LightFault,
    LinkFault,
    PacketFault,
    ReceiverFault,
)
from lidar_emu.session import Block, Session
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder

CATALOGUE = Path(__file__).resolve().parents[2] / "docs" / "faults.md"
RATE_HZ, SHOTS = 50, 100


def kinds_of(*unions: Any) -> set[str]:
    return {
        model.model_fields["kind"].annotation.__args__[0] for union in unions for model in get_args(union)
    }


KINDS = kinds_of(BeamFault, ContentFault, PacketFault)
EACH: list[dict[str, Any]] = [
    *(
        {"kind": kind}
        for kind in ("dropout", "stuck", "frozen", "wrong_sign", "false_invalid", "frozen_counter")
    ),
    *({"kind": kind} for kind in ("lost", "doubled", "reordered", "stale_packet", "truncated", "wrong_crc")),
    *({"kind": kind} for kind in ("silence", "wrong_unit", "wrong_endian")),
    {"kind": "bias", "range_m": 1.0, "ramp_s": 0.1},
    {"kind": "scale", "range_factor": 1.1},
    {"kind": "drift", "range_mps": 1.0},
    {"kind": "noise", "range_m": 1.0, "closing_speed_mps": 0.1},
    {"kind": "outlier", "range_m": [10, 20], "closing_speed_mps": [0, 1]},
    {"kind": "swapped_beams", "beams": [0, 2]},
    {"kind": "false_valid", "range_m": 3.0},
    {"kind": "time_jump", "jump_s": 2.0},
    {"kind": "bit_errors", "rate": 0.01},
    {"kind": "delayed", "delay_s": 0.03},
    {"kind": "garbage", "bytes": 20},
    {"kind": "other_unit", "unit": 2},
    {"kind": "other_version", "version": 3},
]
WHENS = st.one_of(
    st.fixed_dictionaries({"at_s": st.floats(0, 2)}),
    st.builds(
        lambda from_s, length_s, chance: {"from_s": from_s, "to_s": from_s + length_s, **chance},
        st.floats(0, 1.9),
        st.floats(0.01, 0.5),
        st.one_of(
            st.just({}),
            st.fixed_dictionaries({"probability": st.floats(0.05, 0.95), "lasts_s": st.floats(0, 0.2)}),
        ),
    ),
)
ORDERS = st.lists(
    st.builds(lambda fault, when: {**fault, **when}, st.sampled_from(EACH), WHENS), min_size=1, max_size=6
)


def packets(blocks: list[Block]) -> list[Any]:
    return [packet for block in blocks for packet in block.packets]


def sent(blocks: list[Block]) -> list[Any]:
    """Everything that a run reports on its shots: bytes, times, and faults."""
    faults = sorted(fault for block in blocks for fault in block.faults)
    return [packets(blocks), [due for block in blocks for due in block.due_ns], faults]


def test_each_kind_is_here() -> None:
    assert {fault["kind"] for fault in EACH} == KINDS
    assert len(EACH) == len(KINDS)


@given(faults=ORDERS)
@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_shots_that_no_fault_concerns_are_as_without_it(bench: Any, shoot: Any, faults: list[Any]) -> None:
    (good,), (bad,) = shoot(bench()), shoot(bench(*faults))
    concerned = {fault.shot for fault in bad.faults}
    windows = set()
    for fault in faults:
        first_s = fault.get("at_s", fault.get("from_s", 0.0))
        last_s = first_s + 1 / RATE_HZ if "at_s" in fault else fault["to_s"]
        windows |= {k for k in range(SHOTS) if first_s - 1e-9 <= k / RATE_HZ < last_s + 1e-9}
    assert concerned <= windows
    # A packet that is held back follows the next one, wherever that stands.
    concerned |= {fault.shot + 1 for fault in bad.faults if fault.kind == "reordered"}
    for shot in set(range(SHOTS)) - concerned:
        assert bad.packets[shot] == good.packets[shot]
        for name in ("range_m", "closing_speed_mps", "reason", "snr_db"):
            a, b = getattr(good.measurement, name)[shot], getattr(bad.measurement, name)[shot]
            np.testing.assert_array_equal(a, b)


@given(faults=ORDERS, block_shots=st.integers(1, 40))
@settings(deadline=None, max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_blocks_do_not_matter(bench: Any, shoot: Any, faults: list[Any], block_shots: int) -> None:
    scenario = bench(*faults)
    assert sent(shoot(scenario, block_shots)) == sent(shoot(scenario))


@pytest.mark.parametrize("can", [False, True])
def test_a_run_replays_and_another_seed_differs(bench: Any, shoot: Any, can: bool) -> None:
    faults = [
        {**fault, "probability": 0.2, "lasts_s": 0.05}
        for fault in EACH
        if not (can and fault["kind"] == "wrong_crc")
    ]
    once, again, other = (shoot(bench(*faults, seed=seed), can=can) for seed in (5, 5, 6))
    assert sent(once) == sent(again)
    same = sum(bool(a) and a == b for a, b in zip(packets(once), packets(other), strict=True))
    assert same < SHOTS / 2


@pytest.mark.parametrize("back_to", [0, 3, 13, 29])
def test_going_back_computes_the_same_again(bench: Any, back_to: int) -> None:
    scenario = bench(*({**fault, "probability": 0.3, "lasts_s": 0.1} for fault in EACH))
    encoder = Encoder(scenario.wire, False, False, 4)

    def begun() -> Session:
        return Session(build_model(scenario), encoder, 10, faulty_encoder(scenario, encoder, False))

    straight = begun().shoot(SHOTS)
    assert straight is not None
    session = begun()
    for _ in range(6):
        session.shoot(5)
    session.rewind(back_to)
    again = session.shoot(SHOTS)
    assert again is not None
    assert (again.packets, again.due_ns) == (straight.packets[back_to:], straight.due_ns[back_to:])


def test_parts_of_a_block_keep_their_own_faults(bench: Any, shoot: Any) -> None:
    (block,) = shoot(bench({"kind": "lost", "from_s": 0.2, "to_s": 0.4}))
    assert [fault.shot for fault in block.faults] == list(range(10, 20))
    assert [fault.shot for fault in block.part(0, 13).faults] == [10, 11, 12]
    assert block.part(0, 13).due_ns == block.due_ns[:13]


FLIGHT = {"level": "geometric", "duration_s": "4"}
BIAS = {"faults": "[{kind: bias, range_m: 100.0, from_s: 1, to_s: 2, beams: [1]}]"}


def test_points_follow_faulty_ranges() -> None:
    good = simulate(lidar_emu.load("descent.yaml", FLIGHT))
    bad = simulate(lidar_emu.load("descent.yaml", {**FLIGHT, **BIAS}))
    moved = np.linalg.norm(bad.point_site_m - good.point_site_m, axis=-1)
    expected = np.zeros_like(moved)
    expected[20:40, 1] = 100.0
    np.testing.assert_allclose(moved, expected, atol=1e-6)
    np.testing.assert_array_equal(bad.point_site_m[~(expected > 0)], good.point_site_m[~(expected > 0)])


def test_a_run_measures_what_simulate_does(shoot: Any) -> None:
    noise = {"faults": "[{kind: noise, range_m: 2.0, probability: 0.5}, {kind: stuck, from_s: 2.0}]"}
    scenario = lidar_emu.load("descent.yaml", {**FLIGHT, **noise})
    measured, blocks = simulate(scenario), shoot(scenario, 7)
    for name in ("range_m", "closing_speed_mps", "point_site_m", "reason"):
        flown = np.concatenate([getattr(block.measurement, name) for block in blocks])
        np.testing.assert_array_equal(flown, getattr(measured, name))


def command(*words: str) -> str:
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    return done.stdout


ORDERED = (
    "faults=[{kind: dropout, from_s: 1, to_s: 2, beams: [2]}, {kind: lost, at_s: 3}, "
    "{kind: reordered, at_s: 5}, {kind: delayed, delay_s: 0.5, from_s: 6}]"
)


def test_summary_recording_and_plan_report_faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = ["bench.yaml", "--set", ORDERED, "--duration", "8"]
    shown = command("run", *run, "--pace", "max", "--summary", "s.json", "--record", "r.mcap")
    summary = json.loads((tmp_path / "s.json").read_text())
    kinds = {"delayed": 20, "dropout": 10, "lost": 1, "reordered": 1}
    assert summary["faults"] == {"shots": kinds, "suppressed": 1, "held": 1}
    assert (summary["shots"]["due"], summary["shots"]["sent"]) == (80, 78)
    assert "dropout 10, lost 1, reordered 1; 1 packets suppressed, 1 sent with the next one" in shown
    faults, deliveries = [], {}
    with (tmp_path / "r.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=["/fault", "/delivery"]):
            reported = json.loads(message.data)
            if channel.topic == "/fault":
                faults.append(reported)
            else:
                deliveries[reported["shot"]] = reported
    assert faults[0] == {"shot": 10, "fault": 0, "kind": "dropout", "beams": [2]}
    assert len(faults) == 32
    unsent = {shot: row["status"] for shot, row in deliveries.items() if row["status"] != "sent"}
    assert unsent == {30: "suppressed", 50: "held"}
    assert deliveries[60]["due_ns"] - deliveries[59]["due_ns"] == 600_000_000
    planned = json.loads(command("plan", *run, "--json"))["decisions"]
    assert [(row["stage"], row["how"]) for row in planned if row["stage"].startswith("fault")] == [
        ("fault 0", "dropout, beams 2"),
        ("fault 1", "lost"),
        ("fault 2", "reordered"),
        ("fault 3", "delayed, delay_s 0.5"),
    ]


def examples() -> list[list[dict[str, Any]]]:
    texts = re.findall(r"```yaml\n(- .*?)```", CATALOGUE.read_text(), re.S)
    return [[fault] for text in texts for fault in YAML(typ="safe", pure=True).load(text)]


def test_each_fault_has_an_example() -> None:
    described = {fault["kind"] for example in examples() for fault in example}
    assert described == KINDS | kinds_of(LightFault, ReceiverFault, LinkFault, DeviceFault)


@pytest.mark.parametrize("example", examples(), ids=lambda example: example[0]["kind"])
def test_each_example_can_be_flown(bench: Any, shoot: Any, example: list[dict[str, Any]]) -> None:
    can = example[0]["kind"] in ("error_frames", "bus_off")
    if example[0]["kind"] in kinds_of(LightFault, ReceiverFault):
        scenario = lidar_emu.load(
            "descent.yaml", {"site": "flat", "duration_s": "2", "faults": json.dumps(example)}
        )
    else:
        scenario = bench(*example)
    assert sum(len(block.faults) for block in shoot(scenario, 64, can))
    assert len(port_faults(scenario, None, Pace.WALL, can)) == (example[0]["kind"] in kinds_of(LinkFault))

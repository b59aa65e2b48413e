"""Single shots that repeat recorded kernel calls have the bits of shots computed in blocks."""

from __future__ import annotations

import pickle
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidar_emu import EmbeddedDevice
from lidar_emu.measurement import COLUMNS, Measurement
from lidar_emu.packed_measurement import PackedMeasurement, packed
from lidar_emu.scenario.load import load
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model, measure_whole, state_before

FLIGHTS = sorted(
    path.stem
    for path in Path("scenarios").glob("*.yaml")
    if "bench_pattern" not in path.read_text() and path.stem != "live"
)
NESTED = (
    "{ground: {kind: nested, grids: [{kind: generated, size_m: 100, spacing_m: 1},"
    " {kind: generated, size_m: 400, spacing_m: 4, beyond: plane}]}}"
)
BELOW_GROUND = (
    "{pattern: {kind: square, angle_deg: 22.5}, switches: [{kind: altitude, below_m: 1865, datum: ground,"
    " pattern: {kind: square, angle_deg: 7.5}}]}"
)
VARIANTS: dict[str, dict[str, str]] = {
    "plane": {"site": "{ground: {kind: plane, slope_deg: 12}}"},
    "sphere": {"site": "sphere"},
    "cut grid": {"site": "cratered"},
    "nested grids": {"site": NESTED},
    "moving objects": {"site": "yard"},
    "mesh": {"site": "boulder_field"},
    "one beamlet": {"instrument.optics.beamlets": "1"},
    "switch by ground": {"scanner": BELOW_GROUND},
    "vibration": {"vibration": "{along_z: {g_rms: 1}}"},
    "leakage": {"instrument.optics.leakage_db": "-20"},
    "rough ground": {"site.surface.roughness_m": "0.02"},
    "haze and ripple": {"site": "mars", "instrument": "ndl_as_flown"},
    "compensation": {"instrument.detection.compensate": "acceleration"},
}
_MODELS: dict[str, FlightModel] = {}


def model_of(name: str, **keys: str) -> FlightModel:
    """A model, made once for each scenario."""
    key = name + repr(keys)
    if key not in _MODELS:
        built = build_model(load(f"{name}.yaml", keys))
        assert isinstance(built, FlightModel)
        _MODELS[key] = built
    return _MODELS[key]


def assert_same(found: Measurement, expected: Measurement) -> None:
    for name in COLUMNS:
        np.testing.assert_array_equal(
            getattr(found, name), getattr(expected, name), err_msg=name, strict=True
        )


def alone_and_in_a_block(model: FlightModel, first: int, count: int) -> tuple[Measurement, Measurement]:
    state, parts = state_before(model, first), []
    for shot in range(first, first + count):
        part, state = model.measure(shot, 1, state)
        if model.physics is None:
            assert isinstance(part, PackedMeasurement)
        parts.append(part)
    block, _ = model.measure(first, count, state_before(model, first))
    return Measurement.concatenate(parts), block


@pytest.mark.parametrize("name", FLIGHTS)
def test_shipped_flights(name: str) -> None:
    model = model_of(name)
    for first in (0, model.shot_count // 2, model.shot_count - 30):
        assert_same(*alone_and_in_a_block(model, max(first, 0), 30))


def test_pattern_switches() -> None:
    """The pattern of a shot passes to the next one."""
    model = model_of("powered_descent")
    patterns = model.patterns(0, model.shot_count, model.initial_state)
    (switched, *_) = np.flatnonzero(np.diff(patterns))
    single, block = alone_and_in_a_block(model, int(switched) - 5, 10)
    assert len(set(single.pattern.tolist())) == 2
    assert_same(single, block)


@pytest.mark.parametrize("variant", VARIANTS)
def test_variants(variant: str) -> None:
    """Also after a block of another length, for which the model allocates other arrays."""
    model = model_of("descent", **VARIANTS[variant])
    single, block = alone_and_in_a_block(model, 20, 10)
    assert_same(single, block)
    single, block = alone_and_in_a_block(model, 25, 10)
    assert_same(single, block)
    if variant == "switch by ground":
        assert len(set(single.pattern.tolist())) == 2


def test_bridged_gaps(tmp_path: Path) -> None:
    table = "t,up\n0,1000\n1,950\n2,\n3,\n4,800\n5,750\n"
    (tmp_path / "gap.csv").write_text(table)
    trajectory = (
        f"{{kind: table, file: {tmp_path / 'gap.csv'}, time: {{column: t, unit: s}}, up: {{column: up, unit: m}},"
        " maximum_gap_s: 2, longer_gaps: bridge}"
    )
    model = model_of("descent", trajectory=trajectory)
    single, block = alone_and_in_a_block(model, 0, 100)
    assert_same(single, block)
    assert 0 < single.true_in_gap.sum() < single.true_in_gap.size


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"level": "geometric"}, "level geometric"),
        ({"site": "yard", "site.surface.roughness_m": "0.02"}, "edges and roughness"),
    ],
)
def test_what_is_not_repeated_is_in_the_plan(keys: dict[str, str], why: str) -> None:
    model = model_of("descent", **keys)
    (row,) = [each for each in model.plan.decisions if each.stage == "a shot alone"]
    assert (row.how, why in row.reason) == ("as a block of one", True)
    assert not isinstance(model.measure(0, 1, model.initial_state)[0], PackedMeasurement)


SHOTS = 400
Step = tuple[str, int, int]
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("single"), st.integers(0, SHOTS - 1), st.just(1)),
        st.tuples(st.just("run"), st.integers(0, SHOTS - 10), st.integers(1, 5)),
        st.tuples(st.just("block"), st.integers(0, SHOTS - 40), st.integers(2, 40)),
        st.tuples(st.just("command"), st.integers(-1, 1), st.just(0)),
    ),
    min_size=1,
    max_size=12,
)


@given(STEPS)
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
def test_in_any_order(steps: list[Step]) -> None:
    """Single shots, runs of them, blocks and commanded patterns leave no trace in what comes after."""
    repeating, whole = model_of("descent"), model_of("descent", seed="1")
    commanded = None
    for kind, first, count in steps:
        if kind == "command":
            commanded = None if first < 0 else first
            continue
        state = replace(repeating.initial_state, commanded=commanded)
        expected, _ = whole._computed(np.arange(first, first + count, dtype=np.int64), state)
        if kind == "block":
            assert_same(repeating.measure(first, count, state)[0], expected)
            continue
        parts = []
        for shot in range(first, first + count):
            part, state = repeating.measure(shot, 1, state)
            parts.append(part)
        assert_same(Measurement.concatenate(parts), expected)


def test_a_kernel_that_decides_otherwise_is_recorded_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Speeds of a powered descent need filters of several widths, for which the receiver makes room."""
    model = build_model(load("powered_descent.yaml"))
    assert isinstance(model, FlightModel)
    assert model._walk is not None
    records: list[int] = []
    record = model._walk._record
    monkeypatch.setattr(model._walk, "_record", lambda state: records.append(1) or record(state))
    shots = [model.shot_count - 1, 0, model.shot_count // 2, model.shot_count - 2, 1]
    for shot in shots:
        state = state_before(model, shot)
        assert_same(model.measure(shot, 1, state)[0], model._computed(np.array([shot]), state)[0])
    assert 1 < len(records) < len(shots)


def test_faults_of_light_act_in_their_windows() -> None:
    faults = (
        "[{kind: misalignment, tilt_mrad: [1, 0], from_s: 1, to_s: 2},"
        " {kind: alias, decimation: 2, at_s: 3, probability: 0.5}]"
    )
    model = model_of("descent", faults=faults)
    (row,) = [each for each in model.plan.decisions if each.stage == "a shot alone"]
    assert "except where a fault may act" in row.reason
    block, _ = model.measure(10, 70, state_before(model, 10))
    state, found = state_before(model, 10), []
    for shot in range(10, 80):
        single, state = model.measure(shot, 1, state)
        assert isinstance(single, PackedMeasurement) is not (20 <= shot < 40 or shot == 60)
        found.append(single)
    assert_same(Measurement.concatenate(found), block)
    sound = model_of("descent").measure(10, 70, state_before(model, 10))[0]
    assert (block.true_range_m != sound.true_range_m).any(axis=1).sum() == 20


def test_a_flight_that_always_differs_is_not_recorded_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    model = build_model(load("descent.yaml"))
    assert isinstance(model, FlightModel)
    assert model._walk is not None
    monkeypatch.setattr(model._walk, "_repeat", lambda _state: False)
    block, _ = model._computed(np.arange(40), model.initial_state)
    state, found = model.initial_state, []
    for shot in range(40):
        single, state = model.measure(shot, 1, state)
        found.append(single)
    assert_same(Measurement.concatenate(found), block)
    assert [isinstance(single, PackedMeasurement) for single in found] == [True] * 17 + [False] * 23


def test_two_threads_record_at_once() -> None:
    models = [
        build_model(load(f"{name}.yaml"))
        for name in ("descent", "hazards", "terrain_step_2023", "paper_fig2")
    ]
    blocks = [model.measure(0, 20, model.initial_state)[0] for model in models]
    barrier = threading.Barrier(len(models))

    def fly(model: Any) -> Measurement:
        barrier.wait()
        state, parts = model.initial_state, []
        for shot in range(20):
            part, state = model.measure(shot, 1, state)
            parts.append(part)
        return Measurement.concatenate(parts)

    with ThreadPoolExecutor(len(models)) as threads:
        for found, expected in zip(threads.map(fly, models), blocks, strict=True):
            assert_same(found, expected)


def test_live_truth() -> None:
    """Packets of a device with truth that jumps, with and without recorded calls."""

    def flown(repeats: bool) -> list[bytes]:
        device: Any = EmbeddedDevice("live.yaml")
        if not repeats:
            device._session._model._walk = None
        packets = []
        for step in range(1, 120):
            height_m = 500.0 - step if step < 80 else 900.0 - step
            device.set_truth(step * 10_000_000, (0, 0, height_m), (0, 0, -100), (0.0, 2**-0.5, 2**-0.5, 0.0))
            packets += [packet.payload for packet in device.advance(step * 10_000_000)]
        return packets

    packets = flown(True)
    assert len(set(packets)) > 15
    assert packets == flown(False)


def test_a_packed_measurement_is_a_measurement() -> None:
    model = model_of("descent")
    single, _ = model.measure(7, 1, model.initial_state)
    plain, _ = model._computed(np.array([7]), model.initial_state)
    assert len(single) == 1
    assert repr(single) == repr(plain)
    assert_same(pickle.loads(pickle.dumps(single)), plain)
    moved = replace(single, range_m=single.range_m + 1.0)
    np.testing.assert_array_equal(moved.range_m, plain.range_m + 1.0)
    assert_same(PackedMeasurement.of(packed(moved), model.beam_count), moved)
    assert_same(single.one(0), plain)
    with pytest.raises(AttributeError):
        _ = single.rangem_m  # type: ignore[attr-defined]


def test_whole_runs_are_packed_and_unpacked() -> None:
    measured = measure_whole(model_of("paper_fig3", duration_s="0.2"))
    assert_same(PackedMeasurement.of(packed(measured), measured.beam_count), measured)

"""A bench pattern on which every value is known, and what it measures and sends with faults on order."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from lidar_emu.device.state import DeviceConstants, device_constants
from lidar_emu.faults.packets import faulty_encoder
from lidar_emu.scenario.schema import BenchScenario, Scenario
from lidar_emu.session import Block, Session
from lidar_emu.shots.model import Model, build_model
from lidar_emu.wire import Encoder

RATE_HZ = 50
SHOTS = 100

Bench = Callable[..., BenchScenario]
Shoot = Callable[..., list[Block]]
DeviceConstantsOf = Callable[[Scenario, Model], DeviceConstants]


@pytest.fixture
def bench() -> Bench:
    """A bench pattern of two seconds with these faults; range and speed change from shot to shot."""

    def make(*faults: dict[str, Any], seed: int = 1, **keys: Any) -> BenchScenario:
        tree = {
            "name": "bench",
            "seed": seed,
            "timing": {"rate_hz": RATE_HZ},
            "bench_pattern": {
                "duration_s": SHOTS / RATE_HZ,
                "beams": [
                    {
                        "range_m": {"start": 1000 + 100 * beam, "stop": 500, "period_s": 10},
                        "closing_speed_mps": {"start": 50 + beam, "stop": 10, "period_s": 10},
                    }
                    for beam in range(3)
                ]
                + [{"range_m": 700, "closing_speed_mps": 5, "valid": False}],
            },
            "faults": faults,
        }
        return BenchScenario.model_validate_json(json.dumps({**tree, **keys}))

    return make


@pytest.fixture
def device_constants_of() -> DeviceConstantsOf:
    """The constants of a scenario's device."""

    def constants(scenario: Scenario, model: Model) -> DeviceConstants:
        counts = model.beam_count, model.pattern_count
        return device_constants(scenario.device, scenario.timing.rate_hz, *counts, None, scenario.faults)

    return constants


@pytest.fixture
def shoot(device_constants_of: DeviceConstantsOf) -> Shoot:
    """All shots of a scenario, in blocks of `block_shots`."""

    def run(scenario: Scenario, block_shots: int = 128, can: bool = False, fd: bool = False) -> list[Block]:
        model = build_model(scenario)  # type: ignore[arg-type]
        encoder = Encoder(scenario.wire, can, fd, model.beam_count)
        faulty = faulty_encoder(scenario, encoder, can)
        constants = device_constants_of(scenario, model)
        session = Session(model, encoder, faulty=faulty, constants=constants)
        blocks = []
        while (block := session.shoot(block_shots)) is not None:
            blocks.append(block)
        return blocks

    return run

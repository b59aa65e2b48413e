"""Shipped packs: every case flies, and the measurement deceives or loses beams where the case says so."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import lidar_emu
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene import build_scene
from lidar_emu.trial.grading import Deception, grade
from lidar_emu.trial.pack import PreparedCase, read_pack, shipped_packs
from lidar_emu.trial.solutions import from_columns

NOTHING_STATED = from_columns({"time_s": np.zeros(0)})
DECEIVES = {
    "clutter", "wrong_branch", "alias", "false_alarms", "stuck", "frozen", "bias", "scale", "drift", "noise", "outlier",
    "wrong_sign", "swapped_beams", "false_valid",
}  # fmt: skip
LOSES = {"laser_fade", "reflectance_patch", "missing_segment", "dropout", "false_invalid"}


class Flown(NamedTuple):
    measured: Measurement
    altitude_m: FloatArray
    """(shots,) Above the ground straight below."""
    deceptions: list[Deception]


@cache
def flown(pack: str, case: str) -> Flown:
    one = prepared(pack)[case]
    measured = lidar_emu.simulate(str(one.scenario_file), one.case.set, seed=1)
    height_m = build_scene(one.scenario.site).height_m
    east_m, north_m, up_m = measured.position_site_m.T
    altitude_m = up_m - height_m(east_m, north_m)
    return Flown(measured, altitude_m, grade(measured, height_m, NOTHING_STATED).deceptions)


@cache
def prepared(pack: str) -> dict[str, PreparedCase]:
    return {one.case.id: one for one in read_pack(pack, []).cases}


@pytest.mark.parametrize("pack", shipped_packs())
def test_every_case_flies_down_and_measures(pack: str) -> None:
    for case in prepared(pack):
        measured, altitude_m, _ = flown(pack, case)
        assert altitude_m[-1] < altitude_m[0], case
        assert measured.range_valid.any(axis=0).all(), case


def faults() -> Iterator[tuple[str, dict[str, Any]]]:
    for case, one in prepared("faults").items():
        for fault in one.case.set["faults"]:
            yield case, fault


def test_every_fault_of_the_measurement_deceives_or_loses_its_beams() -> None:
    for case, fault in faults():
        measured, _, deceptions = flown("faults", case)
        beams = fault.get("beams", range(measured.beam_count))
        inside = slice(*np.searchsorted(measured.time_ns[:, 0] * 1e-9, [fault["from_s"], fault["to_s"]]))
        for beam in beams:
            if fault["kind"] in DECEIVES:
                meant = [
                    one
                    for one in deceptions
                    if one.beam == beam and fault["from_s"] - 0.1 <= one.from_s < fault["to_s"]
                ]
                assert meant, (case, fault)
            elif fault["kind"] in LOSES:
                lost = ~measured.range_valid[inside, beam]
                # Another fault of the case may report a lost beam as valid.
                assert lost.mean() > 0.1 or "false_valid" in str(prepared("faults")[case].case.set), (
                    case,
                    fault,
                )

"""Shipped packs: every case flies, and the measurement deceives or loses beams where the case says so."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import lidar_emu
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scene import build_scene
from lidar_emu.trial.grading import Deception, grade
from lidar_emu.trial.pack import PreparedCase, read_pack, shipped_packs
from lidar_emu.trial.solutions import from_columns

pytestmark = pytest.mark.slow

NOTHING_STATED = from_columns({"time_s": np.zeros(0)})
DECEIVES = {
    "clutter", "wrong_branch", "alias", "false_alarms", "stuck", "frozen", "bias", "scale", "drift", "noise", "outlier",
    "wrong_sign", "swapped_beams", "false_valid",
}  # fmt: skip
"""Kinds of faults that make a beam report wrong values as valid."""
LOSES = {"laser_fade", "reflectance_patch", "missing_segment", "dropout", "false_invalid"}
"""Kinds of faults that leave a beam without a valid value."""


class Claim(NamedTuple):
    """What the ground, the air or the faults of a case do to the measurement within a band of altitudes."""

    pack: str
    case: str
    what: str
    altitude_m: tuple[float, float]
    least: float


CLAIMS = [
    Claim("terrain", "cliff_down", "step of a range in m", (0, 100), 50),
    Claim("terrain", "cliff_up", "step of a range in m", (0, 100), 35),
    Claim("terrain", "crater_rim", "step of a range in m", (1900, 3000), 1000),
    Claim("terrain", "boulder_field", "share on objects", (60, 80), 0.2),
    Claim("terrain", "boulder_below", "share on objects", (0, 40), 0.2),
    Claim("terrain", "moving_ground", "share on objects", (40, 80), 0.1),
    Claim("terrain", "dark_ground", "share of losses", (500, 2000), 0.2),
    Claim("terrain", "bright_patch", "share of losses", (0, 60), 0.05),
    Claim("terrain", "haze", "deceiving range in m", (400, 1200), 500),
    Claim("terrain", "dust", "deceiving speed in m/s", (0, 30), 5),
    Claim("terrain", "thick_dust", "deceiving speed in m/s", (0, 30), 5),
    Claim("landings", "hakuto_r_m1", "step of a range in m", (1900, 3000), 1000),
    Claim("landings", "hakuto_r_m2", "share of losses", (895, 3000), 0.99),
    Claim("landings", "im_1", "share of losses", (0, 900), 0.99),
    Claim("landings", "im_2", "deceiving range in m", (0, 480), 30),
    Claim("landings", "mars_polar_lander", "deceiving range in m", (1000, 1300), 1000),
    Claim("landings", "mars_polar_lander", "deceiving range in m", (20, 45), 20),
    Claim("landings", "apollo_11", "share of losses", (2800, 3500), 0.99),
    Claim("landings", "hayabusa", "deceiving range in m", (10, 17.5), 5),
    Claim("landings", "curiosity", "deceiving range in m", (750, 960), 7),
    Claim("landings", "curiosity", "deceiving speed in m/s", (0, 25), 1),
]


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
    return Flown(measured, altitude_m, grade(measured, height_m, NOTHING_STATED, {}).deceptions)


@cache
def prepared(pack: str) -> dict[str, PreparedCase]:
    return {one.case.id: one for one in read_pack(pack, []).cases}


@pytest.mark.parametrize("pack", shipped_packs())
def test_every_case_flies_down_and_measures(pack: str) -> None:
    for case in prepared(pack):
        measured = flown(pack, case).measured
        assert measured.position_site_m[-1, 2] < measured.position_site_m[0, 2], case
        assert measured.range_valid.any(axis=0).all(), case


@pytest.mark.parametrize("pack", shipped_packs())
def test_every_case_reaches_the_altitudes_that_its_requirements_judge(pack: str) -> None:
    for case, one in prepared(pack).items():
        altitude_m = flown(pack, case).altitude_m
        for requirement in one.requirements:
            low_m, high_m = requirement.altitude_m or (-np.inf, np.inf)
            judged = np.mean((altitude_m >= low_m) & (altitude_m <= high_m))
            assert judged > 0.05, (case, requirement.id)


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


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.case)
def test_a_case_does_to_the_measurement_what_it_claims(claim: Claim) -> None:
    one = flown(claim.pack, claim.case)
    low_m, high_m = claim.altitude_m
    inside = (one.altitude_m >= low_m) & (one.altitude_m <= high_m)
    assert found(claim.what, one, inside) >= claim.least


def found(what: str, one: Flown, inside: BoolArray) -> float:
    measured = one.measured
    if what == "share of losses":
        return float(np.mean(~measured.range_valid[inside]))
    if what == "share on objects":
        return float(np.mean(measured.truth.object[inside] > 0))
    if what == "step of a range in m":
        return max(largest_step_m(measured, beam, inside) for beam in range(measured.beam_count))
    if what == "deceiving range in m":
        return largest_error("range", measured.range_m - measured.true_range_m, one, inside)
    assert what == "deceiving speed in m/s"
    return largest_error("speed", measured.closing_speed_mps - measured.true_closing_speed_mps, one, inside)


def largest_step_m(measured: Measurement, beam: int, inside: BoolArray) -> float:
    """Largest difference between a range and the last valid one before it."""
    shots = np.flatnonzero(measured.range_valid[:, beam])
    return float(np.abs(np.diff(measured.range_m[shots, beam]))[inside[shots[1:]]].max())


def largest_error(quantity: str, error: FloatArray, one: Flown, inside: BoolArray) -> float:
    """Largest error of the first and last values of deceptions, which are wrong by their definition."""
    at_s = one.measured.time_ns * 1e-9
    ends = [
        np.abs(error[shot, each.beam])
        for each in one.deceptions
        if each.quantity == quantity
        for shot in np.searchsorted(at_s[:, each.beam], [each.from_s - 1e-6, each.until_s - 1e-6])
        if inside[shot]
    ]
    return float(max(ends, default=0.0))

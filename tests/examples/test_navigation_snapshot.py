"""One shot by itself: closed forms, the emulator's own noise, and a real flight."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import snapshot
from beams import Array, DataSheet, Shot, directions, from_message, from_run
from hypothesis import given
from hypothesis import strategies as st
from truth import Truth
from twins import NEW_SHEPARD, NEW_SHEPARD_GEOMETRY

import lidar_emu
from lidar_emu.wire import Encoder
from lidar_protocol import Message, SerialReceiver, default_interface

SQUARE_DEG = np.array([45.0, 135.0, 225.0, 315.0])
SLANTED_FLIGHT = """{kind: profile, path_angle_deg: 60, attitude: {yaw_deg: 20, pitch_deg: 10, roll_deg: -15},
    waypoints: [{altitude_m: 600, speed_mps: 30}, {altitude_m: 350, speed_mps: 20}]}"""


def shot_of(beams: Array, range_m: Array, speed_mps: Array) -> Shot:
    ones = np.ones(len(beams))
    return Shot(0, beams, range_m, 0.1 * ones, speed_mps, 0.001 * ones)


@pytest.mark.parametrize(
    ("azimuth_deg", "angle_deg", "level", "upright"),
    [
        (SQUARE_DEG, 22.5, 1.85, 0.54),
        (SQUARE_DEG, 7.5, 5.42, 0.50),
        (np.array([0.0, 120.0, 240.0]), 22.5, 2.13, 0.62),
    ],
)
def test_velocity_dilution_is_the_closed_form(
    azimuth_deg: Array, angle_deg: float, level: float, upright: float
) -> None:
    """With n beams in a ring it is sqrt(2 / n) / sin across, and 1 / (sqrt(n) cos) along."""
    count, off = len(azimuth_deg), np.radians(angle_deg)
    across, along = (2 / count) ** 0.5 / np.sin(off), 1 / (count**0.5 * np.cos(off))
    assert snapshot.dilution(directions(angle_deg, azimuth_deg)) == pytest.approx([across, across, along])
    assert [across, along] == pytest.approx([level, upright], abs=0.005)


def test_the_emulators_speeds_scatter_as_dilution_says() -> None:
    """1.024 mm/s per beam, as published, times the closed forms. The vehicle is turned: in a flight that two beams see
    from the same angle both round it the same way."""
    scenario = lidar_emu.load(
        "descent",
        {
            "site": "flat",
            "trajectory": SLANTED_FLIGHT,
            "scanner": "{pattern: {kind: square, angle_deg: 22.5}}",
        },
    )
    truth = Truth(scenario)
    off, parities = [], []
    for seed in range(3):
        run = lidar_emu.simulate(scenario, seed=seed)
        for k in np.flatnonzero(run.speed_valid.all(axis=1)):
            solved = snapshot.velocity(from_run(run, k, truth.sheet))
            assert solved is not None
            true = truth.at(int(run.time_ns[k, 0]))
            off.append(solved.value - true.site_from_body.T @ true.velocity_site_mps)
            parities.append(solved.parity[0])
    scatter_mps = np.array(off).std(axis=0)
    assert len(off) > 600
    assert scatter_mps == pytest.approx(1.024e-3 * np.array([1.847, 1.847, 0.541]), rel=0.1)
    assert np.std(parities) == pytest.approx(1, abs=0.1)


@given(
    slope=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    distance_m=st.floats(1, 5000),
    velocity=st.tuples(*[st.floats(-100, 100)] * 3),
    blind=st.sampled_from([None, 0, 1, 2, 3]),
)
def test_a_plane_and_a_velocity_come_back(
    slope: tuple[float, float], distance_m: float, velocity: tuple[float, ...], blind: int | None
) -> None:
    normal = np.array([*slope, -1.0]) / np.linalg.norm([*slope, 1.0])
    beams = directions(22.5, SQUARE_DEG)
    range_m, speed_mps = distance_m / -(beams @ normal), beams @ np.array(velocity)
    if blind is not None:
        range_m[blind] = speed_mps[blind] = np.nan
    shot = shot_of(beams, range_m, speed_mps)
    plane, solved = snapshot.plane(shot), snapshot.velocity(shot)
    assert plane is not None
    assert solved is not None
    assert plane.distance_m == pytest.approx(distance_m)
    assert plane.normal_body == pytest.approx(normal, abs=1e-9)
    assert solved.value == pytest.approx(velocity, abs=1e-9)
    assert len(plane.fit.parity) == len(solved.parity) == (1 if blind is None else 0)
    assert plane.fit.parity == pytest.approx(0, abs=1e-5)


def test_parity_sees_what_three_unknowns_cannot() -> None:
    """A square's one contradiction is (1, -1, 1, -1) / 2: an error e of one beam shows as e / 2 sigma, of opposite
    beams as e / sigma, of neighbours not at all."""
    beams, speed_mps = directions(22.5, SQUARE_DEG), np.zeros(4)
    for wrong, seen in (([0], 0.5), ([0, 2], 1.0), ([0, 1], 0.0)):
        speed_mps[:] = 0
        speed_mps[wrong] = 0.01
        solved = snapshot.velocity(shot_of(beams, np.ones(4), speed_mps))
        assert solved is not None
        assert abs(solved.parity[0]) == pytest.approx(seen * 10, abs=1e-9)


def test_weights_count() -> None:
    """A beam that is a thousand times as noisy contributes next to nothing."""
    beams = directions(22.5, SQUARE_DEG)
    shot = shot_of(beams, np.ones(4), beams @ [1.0, 2.0, 3.0] + [0.5, 0, 0, 0])
    shot.sigma_speed_mps[0] = 1.0
    solved = snapshot.velocity(shot)
    assert solved is not None
    assert solved.value == pytest.approx([1, 2, 3], abs=1e-5)


@pytest.mark.parametrize(
    "beams",
    [
        directions(22.5, SQUARE_DEG[:2]),
        directions(22.5, np.zeros(4)),
        np.full((4, 3), np.nan),
        np.empty((0, 3)),
    ],
    ids=["two", "one direction", "none fired", "none"],
)
def test_too_little_is_no_solution(beams: Array) -> None:
    shot = shot_of(beams, 100 / beams[:, 2], beams[:, 2])
    assert snapshot.velocity(shot) is None
    assert snapshot.plane(shot) is None


def test_packets_and_batch_are_the_same_shots() -> None:
    """Through the emulator's encoder and the decoder that the example uses, to the steps of the wire."""
    scenario = lidar_emu.load("descent", {"duration_s": "2"})
    truth, run = Truth(scenario), lidar_emu.simulate(scenario)
    receiver = SerialReceiver(default_interface())
    packets = Encoder(scenario.wire, can=False, fd=False, beam_count=4).packets(run)
    messages = receiver.receive(b"".join(bytes(packet) for packet in packets))
    assert len(messages) == len(run) == 40
    for k, message in enumerate(messages):
        assert isinstance(message, Message)
        sent, simulated = from_message(message, truth.sheet), from_run(run, k, truth.sheet)
        assert sent is not None
        assert sent.time_ns == pytest.approx(simulated.time_ns, abs=30)
        has_range = np.isfinite(simulated.range_m)
        for one, other, step in zip(sent[1:], simulated[1:], (1e-4, 1e-3, 1e-4, 1e-4, 1e-5), strict=True):
            assert one[has_range] == pytest.approx(other[has_range], abs=step)
        assert np.isnan(sent.range_m[~has_range]).all()


def test_messages_of_other_lidars_are_nothing() -> None:
    sheet = DataSheet(SQUARE_DEG, np.full(4, 22.5), 0.029)
    assert from_message(Message(0, {"time_ns": 5}, ({},) * 3), sheet) is None
    assert from_message(Message(0, {}, ({},) * 4), sheet) is None


def test_a_core_set_is_filled_up_from_the_data_sheet() -> None:
    sheet = DataSheet(SQUARE_DEG, np.full(4, 22.5), 0.029)
    beam = {"range_valid": True, "speed_valid": False, "range_m": 10.0, "closing_speed_mps": 3.0}
    shot = from_message(Message(0, {"time_ns": 5}, (beam,) * 4), sheet)
    assert shot is not None
    assert shot.directions_body == pytest.approx(directions(22.5, SQUARE_DEG))
    assert shot.range_m == pytest.approx([10.0] * 4)
    assert np.isnan(shot.closing_speed_mps).all()
    assert (shot.sigma_range_m > 0).all()


def test_the_descent_of_a_real_lidar(public_data: Path) -> None:
    """New Shepard NS-13, its last ten seconds: straight down, and parity half as large again as the beams' own noise.

    The beams are not square: of one unit of parity the second has 0.85. Doppler dilution by numpy's own inverse.
    """
    geometry = json.loads((public_data / NEW_SHEPARD_GEOMETRY).read_text())
    rows = np.genfromtxt(public_data / NEW_SHEPARD, delimiter=",", skip_header=1)
    time_s = (rows[:, 0] - 1_602_596_210_210_000_000) * 1e-9
    speeds_mps = rows[(time_s > 436.5) & (time_s < 447), 5:9]
    sigmas_mps = np.array(geometry["observed_in_the_csv"]["noise_436p5_to_447s"]["doppler_robust_sigma_mps"])
    beams = np.array(geometry["beam_los_in_CON"])
    assert snapshot.dilution(beams) == pytest.approx(np.sqrt(np.diag(np.linalg.inv(beams.T @ beams))))
    solved = [snapshot.fit(beams, each, sigmas_mps) for each in speeds_mps]
    velocity_mps = np.array([fit.value for fit in solved if fit is not None])
    parity = np.array([fit.parity[0] for fit in solved if fit is not None])
    assert len(parity) == len(speeds_mps) > 100
    level_mps, climb_mps = np.median(velocity_mps[:, :2], axis=0), float(np.median(velocity_mps[:, 2]))
    assert np.abs(level_mps).max() < 0.3
    assert -3.6 < climb_mps < -2.3
    assert 1.0 < np.median(np.abs(parity)) / 0.6745 < 2.0
    assert abs(np.median(parity)) < 0.2
    assert 0.02 < np.mean(parity**2 > 10.83) < 0.3

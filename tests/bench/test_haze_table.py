"""Haze as a target: levels against the reference's shares in evidence/accuracy.md, the plan against random numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import volume_tables
from benchmarks.scenes import FAST_LEVELS
from lidar_emu.plan.detection_forecast import haze_lock_probability
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.load import load
from lidar_emu.scenario.site import Atmosphere, Plane, Site
from lidar_emu.shots.model import build_model

ROOT = Path(__file__).resolve().parents[2]
SHOTS = 400


def committed_rows(name: str) -> list[list[str]]:
    page = (ROOT / "docs" / "evidence" / "accuracy.md").read_text()
    table = page.split(f"<!-- {name}: begin -->")[1].split(f"<!-- {name}: end -->")[0]
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table.split("\n") if "/" in line
    ]


@pytest.mark.slow
@pytest.mark.parametrize("level", FAST_LEVELS)
@pytest.mark.parametrize(("table", "measured"), [("haze", 1000), ("plume", 400)])
def test_shares_are_those_of_the_reference(table: str, measured: int, level: str) -> None:
    rows = {row[0]: np.array(row[1].split("/"), dtype=float) for row in committed_rows(table)}
    for scene in volume_tables.SCENES[table]:
        expected = rows[str(scene)]
        found = volume_tables.shares(scene, level, SHOTS)
        variance = np.maximum(expected * (1.0 - expected), 1.0 / SHOTS) * (1.0 / SHOTS + 1.0 / measured)
        assert (np.abs(found - expected) < 3.5 * np.sqrt(variance)).all(), scene


@pytest.mark.parametrize(("range_m", "snr"), [(200.0, 300.0), (200.0, 30.0), (1500.0, 30.0)])
def test_the_plan_states_how_often_haze_is_the_highest_bin(range_m: float, snr: float) -> None:
    instrument = Instrument()
    air = Atmosphere(extinction_per_m=5e-3, backscatter_per_m_sr=1e-4)
    model = build_receiver(instrument, Site(ground=Plane(kind="plane"), atmosphere=air))
    r = np.arange(0.0, range_m, 1.0 / model.beat_bin_per_m)
    mean = 1.0 + model.haze.snr_per_m / model.beat_bin_per_m * np.exp(-2.0 * 5e-3 * r) / (
        1.0 + (r / model.haze.rayleigh_range_m) ** 2
    )
    rng = np.random.default_rng(2)
    highest = np.concatenate([(mean * rng.exponential(size=(500, len(r)))).max(axis=1) for _ in range(10)])
    ground = (1.0 + snr) * rng.exponential(size=len(highest))
    expected = np.mean((highest > ground) & (highest > model.threshold))
    found = haze_lock_probability(model, np.array([range_m]), np.array([snr]))[0]
    assert found == pytest.approx(expected, abs=0.03)


def test_the_plan_of_the_dust_storm_warns_of_both() -> None:
    haze = next(row for row in build_model(load("dust_storm")).plan.decisions if row.stage == "haze")
    assert haze.computed
    assert "% of chirps and" in haze.reason

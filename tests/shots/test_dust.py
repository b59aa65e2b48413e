"""Dust of the plume, against the closed forms of single scattering and the geometry of a beam over level ground."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.errors import InputError
from lidar_emu.receiver.returns import DUST_FAR_M, DUST_FASTEST_MPS, DUST_NEAR_M, DUST_SLOWEST_MPS, DUST_W
from lidar_emu.receiver.speckle_field import PITCH_W
from lidar_emu.report.geometry_export import record_geometry
from lidar_emu.scenario.instrument import Optics
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_in_blocks, measure_whole

SLANT = 1 / np.cos(np.radians(22.5))
SIDE = np.sin(np.radians(22.5))


def landing(plume: dict[str, Any] | None, **settings):
    """Level ground, 40 m to 4 m, without speckle; below 12 m there is as much dust as there will be."""
    return load("dusty_landing.yaml", {
        "site": "flat",
        "trajectory": "{kind: profile, waypoints: [{altitude_m: 40, speed_mps: 2}, {altitude_m: 4, speed_mps: 1}]}",
        "plume": "null" if plume is None else str(plume),
        "instrument.optics.speckle": "off",
        "scanner": "{pattern: {kind: square, angle_deg: 22.5}}",
        **settings,
    })  # fmt: skip


def echoes_of(scenario):
    """Without dust and with it, and heights."""
    model = build_model(scenario)
    shot = np.arange(model.shot_count)
    pointing, _ = model.aim(shot, model.initial_state)
    hits = model.flight.cast(pointing)
    ground = model.echo_model.echoes(pointing, hits)
    return ground, model.dust.raised(ground, pointing, hits, shot), pointing.vehicle[0, :, 2]


def assert_same(one, other):
    for field in fields(one):
        np.testing.assert_array_equal(
            getattr(one, field.name), getattr(other, field.name), err_msg=field.name
        )


def test_ground_is_dimmed_by_the_depth_there_and_back():
    ground, dusty, height_m = echoes_of(landing({"optical_depth": 0.7, "streak_share": 0.0}))
    growth = np.clip((30 - height_m) / 18, 0, 1)
    beamlets = ground.power_w.shape[-1]
    expected = np.exp(-2 * 0.7 * growth * SLANT)[:, None, None] * ground.power_w
    # The sensor's height is taken at each beam's own time of validity, the vehicle's at the first one's.
    np.testing.assert_allclose(dusty.power_w[..., :beamlets], expected, rtol=1e-9)
    low = height_m < 12
    np.testing.assert_allclose(expected[low] / ground.power_w[low], np.exp(-1.4 * SLANT), rtol=1e-12)


def test_the_sheets_own_light_is_that_of_single_scattering():
    """(1 - exp(-2τ))/(2S), where the ground returns ρ cos θ/π and loses light by depolarisation."""
    ground, dusty, height_m = echoes_of(
        landing({"optical_depth": 0.7, "streak_share": 0.0, "thickness_m": 0.01, "lidar_ratio_sr": 40.0})
    )
    low, beamlets = height_m < 12, ground.power_w.shape[-1]
    whole = ground.power_w[low].sum(axis=-1) / (0.18 / SLANT / np.pi) / Optics().depolarisation
    assert (dusty.power_w[low][..., beamlets:] == 0.0).all()
    sheet = dusty.dust[low][..., DUST_W]
    np.testing.assert_allclose(sheet / whole, (1 - np.exp(-1.4 * SLANT)) / 80, rtol=3e-3)


def test_a_streak_hides_the_sheet_behind_it():
    """The light of sheet and streak is that of one medium with both depths, wherever the streak lies."""
    plume = {"optical_depth": 0.7, "streak_share": 1.0, "streak_optical_depth": 0.4, "thickness_m": 0.01}
    _, plain, height_m = echoes_of(landing(plume | {"streak_share": 0.0}))
    _, dusty, _ = echoes_of(landing(plume))
    low = height_m < 12
    both = dusty.dust[low][..., DUST_W] + dusty.power_w[low][..., -1]
    depth = 0.7 * SLANT
    expected = -np.expm1(-2 * (depth + 0.4)) / -np.expm1(-2 * depth)
    np.testing.assert_allclose(both / plain.dust[low][..., DUST_W], expected, rtol=2e-3)


def test_dust_is_seen_in_the_sheet_and_flees_along_the_ground():
    _, dusty, height_m = echoes_of(
        landing({"thickness_m": 2.0, "speed_mps": 30.0, "speed_spread": 0.2, "streak_share": 1.0})
    )
    low = height_m < 12
    dust = dusty.dust[low]
    np.testing.assert_allclose(dust[..., DUST_FAR_M], dusty.range_m[low][..., 0], atol=0.1)
    np.testing.assert_allclose(dust[..., DUST_FAR_M] - dust[..., DUST_NEAR_M], 2.0 * SLANT, rtol=1e-9)
    slower_mps = dust[..., [DUST_SLOWEST_MPS, DUST_FASTEST_MPS]] - dusty.closing_speed_mps[low][..., :1]
    np.testing.assert_allclose(
        slower_mps, np.broadcast_to([-36 * SIDE, -24 * SIDE], slower_mps.shape), atol=0.05
    )
    streak_m, streak_mps = dusty.range_m[low][..., -1], dusty.closing_speed_mps[low][..., -1]
    assert ((dust[..., DUST_NEAR_M] <= streak_m) & (streak_m <= dust[..., DUST_FAR_M])).all()
    assert ((dust[..., DUST_SLOWEST_MPS] <= streak_mps) & (streak_mps <= dust[..., DUST_FASTEST_MPS])).all()


@pytest.mark.slow
def test_some_beams_lock_on_streaks_as_often_as_asked():
    """A streak of depth 5 hides the ground: a beam that meets one measures the dust."""
    plume = {"optical_depth": 0.0, "streak_share": 0.2, "streak_optical_depth": 5.0, "speed_spread": 0.25}
    run = simulate(landing(plume, **{"timing.rate_hz": "50"}))
    low = (run.position_site_m[:, 2] < 12) & run.range_valid.all(axis=1)
    error_mps = (run.closing_speed_mps - run.true_closing_speed_mps)[low]
    locked = np.abs(error_mps) > 1
    expected = 0.2
    assert abs(locked.mean() - expected) < 4 * np.sqrt(expected * (1 - expected) / locked.size)
    assert (error_mps[locked] < -15 * SIDE + 0.1).all()
    assert (error_mps[locked] > -25 * SIDE - 0.1).all()
    short_m = (run.true_range_m - run.range_m)[low][locked]
    assert -0.4 < short_m.min() < 0.2
    assert 0.8 < short_m.max() < SLANT + 0.4
    # Beams and shots are independent of each other.
    assert abs(np.corrcoef(locked[:-1, 0], locked[1:, 0])[0, 1]) < 0.15
    assert abs(np.corrcoef(locked[:, 0], locked[:, 1])[0, 1]) < 0.15


def test_a_streak_crosses_the_beam_with_the_speed_of_its_dust():
    """Dust at 20 m/s along level ground, a sensor that sinks at 1 m/s, a beam 22.5 degrees off nadir."""
    plume = {"streak_share": 0.5, "speed_mps": 20.0, "speed_spread": 0.0, "onset_height_m": 60.0}
    steady = "{kind: profile, waypoints: [{altitude_m: 20, speed_mps: 1}, {altitude_m: 15, speed_mps: 1}]}"
    _, dusty, _ = echoes_of(landing(plume, trajectory=steady))
    met = np.isfinite(dusty.streak_drift_per_s)
    np.testing.assert_array_equal(met, dusty.power_w[..., -1] > 0.0)
    across_mps = 20.0 / SLANT + SIDE
    expected = across_mps / (PITCH_W * Optics().waist_radius_m)
    assert 0 < met.sum() < met.size
    np.testing.assert_allclose(dusty.streak_drift_per_s[met], expected, rtol=1e-6)


def test_above_the_onset_all_bits_are_those_without_dust():
    clear, dusty = (simulate(landing(None)), simulate(landing({"optical_depth": 2.0})))
    high = int(np.count_nonzero(clear.position_site_m[:, 2] > 30.5))
    assert_same(clear.part(0, high), dusty.part(0, high))
    assert np.nanmax(dusty.snr_db[high + 50 :] - clear.snr_db[high + 50 :]) < -1


def test_in_any_blocks_and_from_a_recorded_geometry(tmp_path):
    scenario = landing({"streak_share": 0.3}, **{"instrument.optics.speckle": "on"})
    whole = simulate(scenario)
    for block_shots in (1, 70):
        blocks = list(measure_in_blocks(build_model(scenario), block_shots))
        assert_same(type(whole).concatenate(blocks), whole)
    record_geometry(landing(None), tmp_path / "g.npz")
    assert_same(measure_whole(build_model(scenario, tmp_path / "g.npz")), whole)


def test_goes_with_faults_of_light():
    patch = "kind: reflectance_patch, centre_m: [0, 0], radius_m: 99, reflectance: 0.9"
    faults = f"[{{kind: clutter, range_m: 1, reflectance: 0.1}}, {{{patch}}}]"
    run = simulate(landing({}, faults=faults))
    plain = simulate(landing({}))
    brighter_db = (run.snr_db - plain.snr_db)[:40]
    np.testing.assert_allclose(np.median(brighter_db), 10 * np.log10(0.9 / 0.18), atol=0.2)


def test_a_patch_of_the_ground_does_not_shine_through_a_streak():
    plume = {"streak_share": 1.0, "streak_optical_depth": 5.0}
    patch = "[{kind: reflectance_patch, centre_m: [0, 0], radius_m: 99, reflectance: 0.02}]"
    plain, patched = (simulate(landing(plume, faults=faults)) for faults in ("[]", patch))
    low = plain.position_site_m[:, 2] < 12
    assert (plain.range_m < plain.true_range_m)[low].any()
    np.testing.assert_allclose(patched.snr_db[low], plain.snr_db[low], atol=0.01)
    assert (patched.snr_db[:40] < plain.snr_db[:40] - 9).all()


@pytest.mark.parametrize(
    ("plume", "key"),
    [
        ({"full_height_m": 30.0}, "plume.full_height_m"),
        ({"optical_depth": -1.0}, "plume.optical_depth"),
        ({"dust": 1.0}, "plume.dust"),
    ],
)
def test_of_bad_dust_the_key_is_named(plume, key):
    with pytest.raises(InputError) as refusal:
        landing(plume)
    assert key in str(refusal.value)


def test_the_plan_reports_it():
    def reported(scenario):
        return [d for d in build_model(scenario).plan.decisions if d.stage == "dust"]

    assert reported(landing(None)) == []
    assert reported(landing({}))[0].computed
    assert "band" in reported(landing({}))[0].how
    assert not reported(landing({}, duration_s="2"))[0].computed

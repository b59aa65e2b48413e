"""Faults of light and receiver: what comes out follows from where they act, against closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import lidar_emu
from lidar_emu.api import simulate
from lidar_emu.beams.footprint import beamlet_pattern
from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.receiver.returns import Reason
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS
from lidar_emu.shots.model import build_model, measure_in_blocks, measure_whole

WAVELENGTH_M, SLOPE_HZ_PER_S, SAMPLE_RATE_HZ, LENGTH = 1550e-9, 2.0e12, 600e6, 131072
INSIDE = slice(10, 30)
WINDOW = "from_s: 0.5, to_s: 1.5"
MEASURED = (
    "range_m", "closing_speed_mps", "range_valid", "speed_valid", "sign_resolved", "reason", "segments", "snr_db",
    "residual_mps", "sigma_range_m", "sigma_speed_mps", "returns", "second_range_m", "true_range_m",
)  # fmt: skip
EACH = [
    "kind: laser_fade, loss_db: 3, ramp_s: 0.3",
    "kind: misalignment, tilt_mrad: [4, -7]",
    "kind: reflectance_patch, centre_m: [0, 0], radius_m: 5000, reflectance: 0.5",
    "kind: clutter, range_m: 60, share: 0.02",
    "kind: missing_segment, segments: [up]",
    "kind: wrong_branch",
    "kind: alias, decimation: 16",
    "kind: false_alarms, noise_db: 3",
]


def flown(*faults: str, **keys: Any) -> Measurement:
    return simulate(scenario(*faults, **keys))


def scenario(
    *faults: str, altitude_m: float = 1000, speed_mps: float = 10, instrument: str = "ndl_fine", **keys: str
) -> Any:
    """Two seconds of nearly steady descent over level ground, without speckle."""
    waypoints = (
        f"[{{altitude_m: {altitude_m}, speed_mps: {speed_mps}}}, "
        f"{{altitude_m: {altitude_m - 2.5 * speed_mps}, speed_mps: {speed_mps}}}]"
    )
    return lidar_emu.load(
        "descent.yaml",
        {
            "site": "flat",
            "instrument": instrument,
            "instrument.optics.speckle": "off",
            "duration_s": "2",
            "trajectory.waypoints": waypoints,
            "faults": "[" + ", ".join(f"{{{fault}}}" for fault in faults) + "]",
            **{name.replace("__", "."): value for name, value in keys.items()},
        },
    )


def in_window(fault: str, **more: Any) -> str:
    return ", ".join([fault, WINDOW, *(f"{name}: {value}" for name, value in more.items())])


def assert_same(good: Measurement, bad: Measurement, where: Any, names: Sequence[str] = MEASURED) -> None:
    for name in names:
        np.testing.assert_array_equal(getattr(good, name)[where], getattr(bad, name)[where], err_msg=name)


@pytest.mark.parametrize("fault", EACH)
def test_what_no_fault_hits_is_as_without_any(fault: str) -> None:
    keys = {"instrument__optics__speckle": "on"}
    whole = fault.startswith("kind: reflectance_patch")
    ordered = in_window(fault) if whole else in_window(fault, beams="[2]")
    good, bad = flown(**keys), flown(ordered, **keys)
    outside = np.ones(40, dtype=bool)
    outside[INSIDE] = False
    assert_same(good, bad, outside)
    if not whole:
        # The incidence, from which sigma_range_m follows, is that on the plane through the points of all beams.
        others = [name for name in MEASURED if name != "sigma_range_m"]
        assert_same(good, bad, (slice(None), [0, 1, 3]), others)
    assert (
        not np.array_equal(good.snr_db[INSIDE, 2], bad.snr_db[INSIDE, 2])
        or not np.array_equal(good.reason[INSIDE, 2], bad.reason[INSIDE, 2])
        or not np.array_equal(good.range_m[INSIDE, 2], bad.range_m[INSIDE, 2])
    )


def test_blocks_do_not_matter() -> None:
    faults = [f"{fault}, probability: 0.3, lasts_s: 0.1" for fault in EACH]
    model = build_model(scenario(*faults, instrument__optics__speckle="on"))
    whole = measure_whole(model)
    for block_shots in (1, 7):
        assert_same(whole, Measurement.concatenate(list(measure_in_blocks(model, block_shots))), slice(None))


def test_fading_by_decibels_lowers_the_snr_by_them() -> None:
    good = flown()
    bad = flown(in_window("kind: laser_fade, loss_db: 4, ramp_s: 0.5", beams="[1]"))
    ramp_db = 4 * np.minimum(1, np.arange(20) * 0.05 / 0.5)
    # The noise at a peak is the same, so that its power does not fall quite as much as the light's.
    lost_db = (good.snr_db - bad.snr_db)[INSIDE, 1]
    np.testing.assert_allclose(lost_db, ramp_db, atol=0.35)
    assert abs(np.mean(lost_db - ramp_db)) < 0.1
    assert bad.range_valid.all()


def test_a_tilt_moves_the_range_by_the_slope_of_the_beam() -> None:
    pattern = {
        "scanner__pattern": "{kind: directions, beams: [[22.5, 0], [22.5, 0]]}",
        "scanner__switches": "[]",
    }
    good = flown(**pattern)
    bad = flown(in_window("kind: misalignment, tilt_mrad: [0, 8], ramp_s: 0.5", beams="[1]"), **pattern)
    tilt_rad = 8e-3 * np.minimum(1, np.arange(20) * 0.05 / 0.5)
    height_m = good.true_range_m[INSIDE, 1] * np.cos(np.radians(22.5))
    expected_m = height_m / np.cos(np.radians(22.5) + tilt_rad)
    np.testing.assert_allclose(bad.true_range_m[INSIDE, 1], expected_m, rtol=1e-9)
    np.testing.assert_allclose(bad.range_m[INSIDE, 1], expected_m, atol=0.2)
    np.testing.assert_array_equal(bad.beam_angle_deg, good.beam_angle_deg)


def test_a_patch_changes_the_echo_of_beams_on_it() -> None:
    good = flown()
    east_m, north_m, _ = good.point_site_m[20, 0]
    bad = flown(f"kind: reflectance_patch, centre_m: [{east_m}, {north_m}], radius_m: 50, reflectance: 1.8")
    assert abs((bad.snr_db - good.snr_db)[:, 0].mean() - 10) < 0.1
    assert_same(good, bad, (slice(None), [1, 2, 3]))


@pytest.mark.parametrize("ground", ["grid", "plane"])
def test_a_patch_under_a_part_of_the_footprint_takes_that_part(ground: str) -> None:
    """A beam straight down is sampled by beamlets on a grid, and by a single one on level ground."""
    keys: Any = {
        "site": "mare" if ground == "grid" else "flat",
        "scanner__pattern": "{kind: directions, beams: [[0, 0]]}",
        "scanner__switches": "[]",
        "speed_mps": 1e-3,
    }
    good = flown(**keys)
    radius_m = 0.017 * np.hypot(1, good.true_range_m[0, 0] * WAVELENGTH_M / (np.pi * 0.017**2))
    east_m, north_m, _ = good.position_site_m[0]
    # The disc is so large that its edge is straight; it runs between the middle beamlets and the next.
    far_m = east_m + 1e4 + 0.05 * radius_m
    bad = flown(
        f"kind: reflectance_patch, centre_m: [{far_m}, {north_m}], radius_m: 1.0e4, reflectance: 0", **keys
    )
    loss_db = (good.snr_db - bad.snr_db)[:, 0]
    if ground == "plane":
        np.testing.assert_array_equal(loss_db, 0)
        return
    # Across a beam straight down, the pattern's first axis is east.
    offset_w, weight = beamlet_pattern(19)
    expected_db = -10 * np.log10(weight[offset_w[:, 0] < 0.05].sum())
    assert 1 < expected_db < 2
    np.testing.assert_allclose(loss_db, expected_db, atol=0.1)


PUBLISHED = {"instrument": "ndl_as_published"}


@pytest.mark.parametrize(("share", "wins"), [(0.2, True), (1e-5, False)])
def test_clutter_competes_with_the_ground_by_its_power(share: float, wins: bool) -> None:
    good = flown(**PUBLISHED)
    bad = flown(in_window(f"kind: clutter, range_m: 60, reflectance: 0.9, share: {share}"), **PUBLISHED)
    if not wins:
        np.testing.assert_array_equal(bad.range_m, good.range_m)
        return
    # Its line without shift is as strong as the cosine of a phase by chance, and is seen in bin 1 at the least.
    seen = bad.range_valid[INSIDE]
    assert seen.mean() > 0.7
    np.testing.assert_allclose(bad.range_m[INSIDE][seen], 60, atol=0.4)
    np.testing.assert_allclose(bad.closing_speed_mps[INSIDE][seen], 0, atol=4e-3)
    assert bad.true_range_m.min() > 900
    # Of two surfaces in a beam of Rayleigh range z, power goes as albedo times share over 1 + (R/z)².
    rayleigh_m = np.pi * 0.017**2 / WAVELENGTH_M
    angle = np.cos(np.radians(22.5))
    ground = 0.18 * angle / (1 + (good.true_range_m[INSIDE] / rayleigh_m) ** 2)
    structure = 0.9 * share / (1 + (60 / rayleigh_m) ** 2)
    expected_db = 10 * np.log10(structure / ground)
    # Bins of half a step's distance lose 1.7 dB of a line.
    assert abs(np.median((bad.snr_db - good.snr_db)[INSIDE] - expected_db)) < 2.0


tenths = st.integers(0, 20)
dimming = st.one_of(
    st.integers(1, 6).map(lambda loss_db: ("kind: laser_fade, loss_db: {}", loss_db, float(loss_db))),
    st.integers(1, 8).map(
        lambda part: (
            "kind: clutter, range_m: 60, reflectance: 1.0e-9, share: {}",
            part / 10,
            -10 * np.log10(1 - part / 10),
        )
    ),
)


TWICE = (("kind: clutter, range_m: 60, reflectance: 1.0e-9, share: {}", 0.8, -10 * np.log10(0.2)), 0, 9)


@settings(max_examples=15)
@given(st.lists(st.tuples(dimming, tenths, tenths), min_size=1, max_size=3))
@example([TWICE, TWICE])
def test_the_ground_has_what_fades_and_dark_clutter_leave_of_it(drawn: list[Any]) -> None:
    """In any number and at any time: powers are multiplied."""
    faults, expected_db = [], np.zeros(40)
    for (words, value, loss_db), first, last in drawn:
        start, end = min(first, last), max(first, last) + 1
        faults.append(f"{words.format(value)}, from_s: {start / 10}, to_s: {end / 10}")
        expected_db[2 * start : 2 * end] += loss_db
    good, bad = (flown(*orders, altitude_m=100) for orders in ((), faults))
    # The noise of the weaker line: a measured SNR of s scatters by 6.1 / sqrt(s) dB in each of three segments.
    scatter_db = 6.1 / np.sqrt(3 * 10 ** (bad.snr_db[:, 0] / 10))
    apart = ((good.snr_db - bad.snr_db)[:, 0] - expected_db) / scatter_db
    assert np.abs(apart).max() < 4.0


def test_without_a_segment_goes_by_the_rule() -> None:
    lost = in_window("kind: missing_segment, segments: [up]")
    strict = flown(lost)
    assert (strict.reason[INSIDE] == Reason.BELOW_THRESHOLD).all()
    assert (strict.segments[INSIDE] == 0b110).all()
    any_two = flown(lost, instrument__detection__rule="any_two")
    np.testing.assert_allclose(any_two.range_m[INSIDE], any_two.true_range_m[INSIDE], atol=0.3)
    assert (any_two.segments[INSIDE] == 0b110).all()
    assert not any_two.sign_resolved[INSIDE].any()
    assert np.isnan(any_two.residual_mps[INSIDE]).all()
    alone = flown(
        in_window("kind: missing_segment, segments: [up, down]"), instrument__detection__rule="any_two"
    )
    assert not alone.range_valid[INSIDE].any()


@pytest.mark.parametrize(
    ("instrument", "lost"), [("ndl_fine", False), ("ndl_four_beam", False), ("ndl_fine", True)]
)
def test_the_wrong_branch_is_wrong_in_range_and_speed_alike(instrument: str, lost: bool) -> None:
    faults, keys = [in_window("kind: wrong_branch")], {}
    if lost:
        faults.append(in_window("kind: missing_segment, segments: [up]"))
        keys = {"instrument__detection__rule": "any_two"}
    bad = flown(*faults, instrument=instrument, speed_mps=4, **keys)
    speed_mps = bad.true_closing_speed_mps[INSIDE]
    too_far_m = 2 * SPEED_OF_LIGHT_MPS * speed_mps / (WAVELENGTH_M * SLOPE_HZ_PER_S)
    assert bad.range_valid[INSIDE].all()
    np.testing.assert_allclose(bad.closing_speed_mps[INSIDE], -speed_mps, atol=2e-3)
    np.testing.assert_allclose(bad.range_m[INSIDE], bad.true_range_m[INSIDE] + too_far_m, atol=0.5)
    assert (bad.sign_resolved[INSIDE] == (not lost)).all()


def test_both_chirps_alone_report_the_sign() -> None:
    faults = [in_window("kind: wrong_branch"), in_window("kind: missing_segment, segments: [constant]")]
    bad = flown(*faults, instrument__detection__rule="any_two")
    assert (bad.reason[INSIDE] == Reason.AMBIGUOUS).all()


def test_an_alias_is_folded_at_the_new_limit() -> None:
    # A quarter of the samples: beats are folded at 75 MHz, ranges at 5.6 km.
    bad = flown(
        in_window("kind: alias, decimation: 4"),
        altitude_m=7000,
        speed_mps=2,
        instrument="ndl_four_beam",
        instrument__optics__laser_power_w="100",
        instrument__waveform__linewidth_hz="0",  # at 7 km the line's peak may lie bins away
    )
    folds_m = SPEED_OF_LIGHT_MPS / (2 * SLOPE_HZ_PER_S) * SAMPLE_RATE_HZ / 4 / 2
    assert (bad.true_range_m > folds_m).all()
    assert bad.range_valid.all()
    np.testing.assert_allclose(bad.range_m[:10], bad.true_range_m[:10], atol=1.1)
    np.testing.assert_allclose(bad.range_m[INSIDE], 2 * folds_m - bad.true_range_m[INSIDE], atol=1.1)
    # Both chirps are folded: closing looks like receding.
    np.testing.assert_allclose(bad.closing_speed_mps[INSIDE], -bad.true_closing_speed_mps[INSIDE], atol=0.02)


@pytest.mark.parametrize(
    ("fault", "lost_db"),
    [("kind: alias, decimation: 4", 10 * np.log10(4)), ("kind: false_alarms, noise_db: 3", 3)],
)
def test_noise_lowers_the_snr(fault: str, lost_db: float) -> None:
    good, bad = flown(), flown(in_window(fault))
    assert abs((good.snr_db - bad.snr_db)[INSIDE].mean() - lost_db) < 0.15


def test_false_alarms_come_at_the_rate_of_the_model() -> None:
    # In the dark a spectrum of N/2 independent bins exceeds t with 1 - (1 - exp(-t))^(N/2).
    keys = {
        "instrument__optics__laser_power_w": "1.0e-12",
        "instrument__detection__window": "rect",
        "instrument__detection__peak": "bin",
        "timing__rate_hz": "500",
    }
    noise_db = 2.0
    bad = flown(f"kind: false_alarms, noise_db: {noise_db}", **keys)
    threshold = np.log(LENGTH / 2 / 1e-3) / 10 ** (noise_db / 10)
    rate = -np.expm1(LENGTH / 2 * np.log1p(-np.exp(-threshold)))
    assert 0.3 < rate < 0.7
    detected = np.unpackbits(bad.segments.reshape(-1, 1), axis=1, bitorder="little")[:, :3]
    # The three segments are independent: check the rates of each, of each pair and of all three.
    for one_or_more in ([0], [1], [2], [0, 1], [1, 2], [0, 2], [0, 1, 2]):
        share = rate ** len(one_or_more)
        found = detected[:, one_or_more].all(axis=1).mean()
        assert abs(found - share) < 5 * np.sqrt(share * (1 - share) / len(detected)), one_or_more
    assert flown(**keys).segments.astype(bool).mean() < 0.02


@pytest.mark.parametrize(
    ("fault", "keys", "reported"),
    [
        ("kind: laser_fade, loss_db: 1", {"level": "geometric"}, "use level spectral"),
        ("kind: clutter, range_m: 3", {"level": "geometric"}, "use level spectral"),
        (
            "kind: alias, decimation: 2",
            {"level": "reference", "instrument__optics__speckle": "on"},
            "use level spectral",
        ),
        ("kind: wrong_branch, beams: [4]", {}, "must be beams of the scenario, 0 to 3"),
        (
            "kind: reflectance_patch, centre_m: [0, 0], radius_m: 1, reflectance: 1",
            {"site__surface__reflectance": "0"},
            "use a site.surface.reflectance above 0",
        ),
    ],
)  # fmt: skip
def test_what_a_flight_cannot_do_is_refused(fault: str, keys: dict[str, str], reported: str) -> None:
    with pytest.raises(InputError, match=reported):
        build_model(scenario(fault, **keys))


def test_a_bench_pattern_has_no_physics(bench: Any) -> None:
    with pytest.raises(InputError, match=r"faults.0.kind: wrong_branch on a bench pattern"):
        build_model(bench({"kind": "wrong_branch"}))


def test_a_receiver_with_negligible_noise_sees_a_plume_as_the_sound_one() -> None:
    """Streaks of dust stay targets of their own beside the footprint's, though of no surface."""
    keys = {"timing.rate_hz": "5"}
    fault = "[{kind: false_alarms, noise_db: 1.0e-9}]"
    sound, faulty = (
        simulate(lidar_emu.load("dusty_landing", keys | more)) for more in ({}, {"faults": fault})
    )
    assert (sound.second_reason == Reason.AMBIGUOUS).any()
    np.testing.assert_array_equal(faulty.second_reason, sound.second_reason)
    np.testing.assert_allclose(faulty.range_m, sound.range_m, rtol=1e-6)

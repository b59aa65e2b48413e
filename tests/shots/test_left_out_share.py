"""What a run leaves out changes its errors by no more than the share of sigma that the scenario allows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from exchanged_speckle import robust

import lidar_emu
from lidar_emu.errors import InputError
from lidar_emu.scenario.load import load

SHOTS = 1000
FLAT = "{adc: null, bandwidth_hz: null, ac_coupling_hz: 0}"


def _scene(rng: np.random.Generator) -> dict[str, str]:
    """A beam over smooth or rough ground, near or far, slow or fast, rounded to bins or not."""
    altitude_m, speed_mps = 10 ** rng.uniform(1.5, 3.4), 10 ** rng.uniform(0.0, 2.0)
    path_deg, tilt_deg = rng.choice([0.5, 3.0, 10.0]), rng.uniform(0.0, 25.0)
    half_m = min(0.05 * altitude_m, 2.0)
    waypoints = ", ".join(
        f"{{altitude_m: {altitude_m + side * half_m}, speed_mps: {speed_mps}}}" for side in (1, -1)
    )
    flown_s = 2.0 * half_m / (speed_mps * float(np.sin(np.radians(path_deg))))
    # Shots at least 0.1 m apart, so that they fade independently.
    rate_hz = min(SHOTS / flown_s, 10.0 * speed_mps)
    linewidth_hz, receiver = rng.choice([0, 3000]), rng.choice(["{}", FLAT])
    base = rng.choice(["ndl_four_beam", "ndl_fine"])
    return {
        "timing.rate_hz": str(rate_hz),
        "duration_s": str(0.9 * flown_s),
        "instrument": f"{{base: {base}, waveform: {{linewidth_hz: {linewidth_hz}}}, receiver: {receiver}}}",
        "site": rng.choice(["flat", "{base: flat, surface: {lommel_seeliger_share: 1}}"]),
        "scanner": f"{{pattern: {{kind: directions, beams: [[{tilt_deg}, 0], [{tilt_deg}, 120]]}}}}",
        "trajectory": f"{{kind: profile, path_angle_deg: {path_deg}, waypoints: [{waypoints}]}}",
    }


def _errors(settings: dict[str, str], **keys: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of range and closing speed and their stated sigmas, (2, n), and where a measurement is valid and right."""
    run = lidar_emu.simulate(load("descent", settings | keys))
    errors = np.array([run.range_m - run.true_range_m, run.closing_speed_mps - run.true_closing_speed_mps])
    sigmas = np.array([run.sigma_range_m, run.sigma_speed_mps])
    return errors, sigmas, run.range_valid & (np.abs(errors[0]) < 3.4)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(200))
def test_random_scenes_scatter_alike(seed: int) -> None:
    settings = _scene(np.random.default_rng(seed))
    (some, _, left), (whole, sigmas, all_of) = _errors(settings), _errors(settings, left_out_share="0")
    both = left & all_of
    if both.mean() < 0.3:
        return
    assert abs(left.mean() - all_of.mean()) < 0.01 + 3.0 * np.sqrt(0.25 / left.size)
    for without, computed, sigma in zip(some[:, both], whole[:, both], sigmas[:, both], strict=True):
        moved = without - computed
        if "four_beam" in settings["instrument"]:
            # Rounded frequencies stay in their bins while a scene hardly changes: sigma is over all places in a bin.
            expected, middle = np.median(sigma), np.mean(moved)
            grown = np.sqrt(np.mean(without**2)) - np.sqrt(np.mean(computed**2))
            doubt = np.std(moved) / np.sqrt(moved.size)
            # At the edge of two bins any scatter moves the mean; over all places in a bin it does not.
            most = np.inf
        else:
            # Speckle makes the errors of sub-bin peaks heavy-tailed.
            expected, middle = robust(computed), np.median(moved)
            grown = robust(without) - expected
            doubt = 1.25 * robust(moved) / np.sqrt(moved.size)
            most = 0.05
        # Deviations of n errors are known to 0.9/√n; most of it is common to the two.
        assert grown < (0.05 + 2.0 / np.sqrt(moved.size)) * expected + 3.0 * doubt
        assert abs(middle) < most * expected + 3.0 * doubt


@pytest.mark.parametrize("share", ["-0.1", "0.6", "nan", "much"])
def test_shares_beyond_a_half_are_refused(share: str) -> None:
    with pytest.raises(InputError, match="left_out_share"):
        load("descent", {"left_out_share": share})

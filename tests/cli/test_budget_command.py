"""`lidar-emu budget`: its rows beside closed forms, and what its users see."""

from __future__ import annotations

import json
from math import cos, pi, radians, sin, sqrt, tan
from typing import Any

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.plan import uncertainty

C_MPS, WAVELENGTH_M, SLOPE_HZ_PER_S, RECORD_S = 299_792_458.0, 1550e-9, 2e12, 2**17 / 600e6
BIN_HZ = 1.0 / RECORD_S
RANGE_BIN_M, SPEED_BIN_MPS = 0.5 * C_MPS * BIN_HZ / SLOPE_HZ_PER_S, 0.5 * WAVELENGTH_M * BIN_HZ


@pytest.fixture(autouse=True)
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uncertainty, "DRAWS", 10_000)
    monkeypatch.setattr(uncertainty, "_DRAWS_OFF", 1_000)


def sheet(*words: str) -> dict[str, Any]:
    done = CliRunner().invoke(cli, ["budget", "descent.yaml", "--json", *words])
    assert done.exit_code == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document


def rows(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in document["sources"]}


def test_rows_of_the_published_instrument_are_closed_forms() -> None:
    document = sheet("--at", "1500")
    found, range_m = rows(document), document["range_m"]
    tilt = radians(document["incidence_deg"])

    quantised = found["quantisation"]
    assert quantised["input_uncertainty"] == pytest.approx(BIN_HZ / sqrt(12.0), rel=0.03)
    assert quantised["range_m"]["uncertainty"] == pytest.approx(RANGE_BIN_M / sqrt(6.0), rel=0.03)
    assert quantised["range_m"]["half_width_95"] == pytest.approx(RANGE_BIN_M * (1.0 - sqrt(0.05)), rel=0.03)
    assert quantised["speed_mps"]["uncertainty"] == pytest.approx(SPEED_BIN_MPS / sqrt(12.0), rel=0.03)
    # White noise of the phase, 2πΔντ², through the weights π/2 cos πx of half bins on the frequency.
    delay_s = 2.0 * range_m / C_MPS
    line_hz = sqrt(3e3 * pi**3 / 16.0 / RECORD_S**3) * delay_s
    assert found["line"]["input_uncertainty"] == pytest.approx(line_hz, rel=0.03)
    ripple = found["ripple"]
    assert ripple["range_m"]["uncertainty"] > 0.0 == ripple["speed_mps"]["uncertainty"]

    # 1 g rms, flat from 20 to 2000 Hz, along all axes.
    own_mps = 9.80665 * sqrt((1.0 / 20.0 - 1.0 / 2000.0) / 1980.0) / (2.0 * pi)
    assert found["vibration"]["input_uncertainty"] == pytest.approx(own_mps, rel=0.01)
    assert found["alignment"]["range_m"]["uncertainty"] == pytest.approx(
        range_m * tan(tilt) * 23e-6 / sqrt(2.0), rel=1e-6
    )
    assert found["clock"]["range_m"]["half_width_95"] == pytest.approx(0.95 * sqrt(3.0) * 1e-6 * range_m)
    assert found["terrain model"]["range_m"]["uncertainty"] == pytest.approx(3.5 / cos(tilt), rel=0.03)
    assert found["terrain model"]["speed_mps"]["uncertainty"] == 0.0


def test_noise_of_a_steady_echo_is_near_the_cramer_rao_bound() -> None:
    steady = "--set", "instrument=ndl_fine", "--set", "instrument.optics.speckle=off"
    document = sheet("--at", "500", *steady)
    found = rows(document)
    bound_hz = BIN_HZ * 0.3898 * 10.0 ** (-0.05 * document["snr_db"])
    noise = found["noise"]
    assert 1.0 < noise["input_uncertainty"] / bound_hz < 1.1
    assert noise["range_m"]["uncertainty"] == pytest.approx(
        sqrt(0.5) * RANGE_BIN_M * noise["input_uncertainty"] / BIN_HZ, rel=0.05
    )
    assert (noise["law"], noise["has_variance"]) == ("normal", True)
    # Speckle is off, and appears with the size that it would have.
    speckle = found["speckle"]
    assert (speckle["on"], speckle["law"], speckle["has_variance"]) == (False, "Student t", False)
    assert speckle["range_m"]["uncertainty"] > noise["range_m"]["uncertainty"]


def test_sources_combine_to_the_coverage_factors_of_their_laws() -> None:
    """Vibration that exceeds all others is normal; a bin's width is a triangle of range and uniform in speed."""
    shaken = "{along_x: {g_rms: 30}, along_y: {g_rms: 30}, along_z: {g_rms: 30}}"
    normal = sheet("--at", "500", "--set", f"vibration={shaken}")
    for key in ("range_error_m", "speed_error_mps"):
        error = normal[key]
        assert error["coverage_factor_68"] == pytest.approx(1.0, rel=0.03)
        assert error["coverage_factor_95"] == pytest.approx(1.96, rel=0.03)
        of_rows = [
            row[key.replace("_error", "")]["uncertainty"]
            for row in normal["sources"]
            if row["on"] and row["law"] != "known"
        ]
        assert error["uncertainty"] == pytest.approx(sqrt(sum(part**2 for part in of_rows)))
    assert rows(normal)["vibration"]["on"]

    as_published = sheet("--at", "500", "--set", "instrument=ndl_as_published")
    assert as_published["range_error_m"]["coverage_factor_95"] == pytest.approx(
        (1.0 - sqrt(0.05)) * sqrt(6.0), rel=0.03
    )
    assert as_published["speed_error_mps"]["coverage_factor_95"] == pytest.approx(0.95 * sqrt(3.0), rel=0.03)


def test_a_misaligned_beam_has_a_known_error() -> None:
    tilted = sheet("--at", "1500", "--set", "scanner.misalignment_mrad=[[1, 0], [0, 0], [0, 0], [0, 0]]")
    row = rows(tilted)["alignment"]
    assert (row["on"], row["law"]) == (True, "known")
    # A turn about one axis of the body moves a beam that is at 22.5° between two of them.
    turned_rad = 1e-3 * sqrt(1.0 - 0.5 * sin(radians(22.5)) ** 2)
    assert row["input_uncertainty"] == pytest.approx(turned_rad, rel=1e-3)
    without = sheet("--at", "1500")
    moved_m = tilted["range_error_m"]["systematic"] - without["range_error_m"]["systematic"]
    assert abs(moved_m) == pytest.approx(row["range_m"]["uncertainty"], rel=0.05)

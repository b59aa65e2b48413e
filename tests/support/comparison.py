"""Decoded rows beside the simulation: equal to half a step of the wire, and nothing where there is nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lidar_emu.measurement import Measurement

FLAGS = ("fired", "range_valid", "speed_valid", "sign_resolved")
CODES = ("segments", "reason", "returns", "second_reason")
SERIAL_STEPS = {
    "snr_db": 0.01,
    "range_m": 0.001,
    "closing_speed_mps": 0.0001,
    "second_range_m": 0.001,
    "sigma_range_m": 0.0001,
    "sigma_speed_mps": 0.00001,
    "residual_mps": 0.0001,
    "beam_angle_deg": 0.01,
    "second_sigma_range_m": 0.0001,
}
SERIAL_HELD = {
    "sigma_range_m": (0.0, 6.5534),
    "sigma_speed_mps": (0.0, 0.65534),
    "residual_mps": (-3.2767, 3.2767),
    "second_sigma_range_m": (0.0, 6.5534),
}


def assert_equal(
    rows: Sequence[Mapping[str, Any]],
    simulated: Measurement,
    steps: Mapping[str, float] = SERIAL_STEPS,
    held: Mapping[str, tuple[float, float]] = SERIAL_HELD,
    exact: Sequence[str] = FLAGS + CODES,
) -> None:
    """Each row is its shot and beam of the simulation.

    Args:
        rows: with `shot` and `beam`; None where the packet marks the value as missing.
        simulated: all shots.
        steps: of the wire, for each value compared.
        held: values that are sent as the nearest end of their range.
        exact: flags and codes compared.
    """
    place = [row["shot"] for row in rows], [row["beam"] for row in rows]
    assert rows
    for name in exact:
        np.testing.assert_array_equal([row[name] for row in rows], getattr(simulated, name)[place], name)
    for name, step in steps.items():
        received = np.array([row[name] for row in rows], dtype=np.float64)
        expected = np.clip(getattr(simulated, name)[place], *held.get(name, (-np.inf, np.inf)))
        np.testing.assert_allclose(received, expected, rtol=0, atol=0.5 * step * (1 + 1e-6), err_msg=name)


def assert_complete(rows: Sequence[Mapping[str, Any]], summary: Mapping[str, Any], beams: int) -> None:
    """What arrived is what was sent, each shot once and in order; the summary accounts for every other one."""
    shots = summary["shots"]
    assert shots["due"] == summary["planned_shots"]
    assert shots["sent"] + shots["late"] + sum(shots["dropped"].values()) == shots["due"]
    arrived = [row["shot"] for row in rows]
    assert len(arrived) == beams * shots["sent"]
    assert arrived[::beams] == sorted(set(arrived))
    assert [row["beam"] for row in rows] == list(range(beams)) * shots["sent"]

"""Firmware flies on an emulated PowerPC with a CAN controller of QEMU, on vcan0 beside the emulator."""

from __future__ import annotations

from pathlib import Path

import pytest
from flown_firmware import ON_CAN, assert_commanded, assert_shots, assert_solutions, flown


def test_a_flight_on_can(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = flown(ON_CAN, tmp_path, monkeypatch)
    # How many shots are sent and arrive depends on the machine: one processor computes them, and the firmware too.
    assert 0 < len(flight.numbers) <= flight.sent
    # Frames that the controller had no room for count as bad, whatever they belong to.
    lost, _ = flight.lost_and_bad
    assert lost == flight.numbers[-1] - flight.numbers[0] + 1 - len(flight.numbers)
    assert_shots(ON_CAN, flight.shots)
    assert_solutions(flight)
    assert_commanded(flight)

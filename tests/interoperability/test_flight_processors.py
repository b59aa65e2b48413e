"""Firmware flies on emulated processors: it receives every shot with the values of `simulate`, and commands.

On CAN it flies in tests/integration/socketcan.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from flown_firmware import ON_CAN, PROCESSORS, assert_commanded, assert_shots, assert_solutions, flown

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("processor", [name for name in PROCESSORS if name != ON_CAN])
def test_a_flight(processor: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = flown(processor, tmp_path, monkeypatch)
    # How many shots are late, and not sent, depends on the machine. What is sent arrives.
    assert len(flight.numbers) == flight.sent > 0
    assert flight.lost_and_bad == (flight.numbers[-1] - flight.numbers[0] + 1 - flight.sent, 0)
    assert_shots(processor, flight.shots)
    assert_solutions(flight)
    assert_commanded(flight)

"""The computing time that the plan states, with a clock that counts the shots."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.shots import model as run_time
from lidar_emu.shots.model import estimate_run_s


def counting_clock(
    monkeypatch: pytest.MonkeyPatch, cost_ns: Callable[[int], int]
) -> tuple[Callable[[], int], list[tuple[int, int]]]:
    """A clock that advances by `cost_ns(count)` with each block that is measured; and the measured blocks."""
    measured: list[tuple[int, int]] = []

    def measure(_model: object, first: int, count: int, _state: object) -> None:
        measured.append((first, count))

    monkeypatch.setattr(run_time, "measure", measure)
    monkeypatch.setattr(run_time, "state_before", lambda *_: None)
    monkeypatch.setattr(run_time, "initial_state", lambda _: SimpleNamespace(faults=()))
    return lambda: sum(cost_ns(count) for _, count in measured), measured


@pytest.mark.parametrize(
    ("shots", "shot_ns", "blocks"),
    [
        (1000, 10**6, [(500, 1), (500, 1), (500, 128)]),
        (100, 10**6, [(50, 1), (50, 1), (50, 50)]),
        (1, 10**6, [(0, 1), (0, 1), (0, 1)]),
        # A block would take minutes.
        (1000, 10**9, [(500, 1), (500, 1)]),
    ],
)
def test_a_block_in_the_middle_is_timed(monkeypatch, shots: int, shot_ns: int, blocks) -> None:
    now_ns, measured = counting_clock(monkeypatch, lambda count: shot_ns * count)
    assert estimate_run_s(SimpleNamespace(shot_count=shots), now_ns) == pytest.approx(shots * shot_ns * 1e-9)
    assert measured == blocks


def test_what_a_call_costs_is_shared_by_the_shots_of_a_block(monkeypatch) -> None:
    now_ns, _ = counting_clock(monkeypatch, lambda count: 128_000 + 1000 * count)
    assert estimate_run_s(SimpleNamespace(shot_count=1280), now_ns) == pytest.approx(10 * 256e-6)


def planned(*arguments: str) -> dict:
    return json.loads(CliRunner().invoke(cli, ["plan", *arguments, "--json"], standalone_mode=False).stdout)


def test_only_flights_that_are_known_before_they_start_are_timed() -> None:
    assert planned("descent.yaml")["computing_time_s"] > 0.0
    assert planned("bench.yaml")["computing_time_s"] is None
    assert planned("live.yaml")["computing_time_s"] is None
    shown = CliRunner().invoke(cli, ["plan", "descent.yaml"], standalone_mode=False).stdout
    assert "computing time: " in shown
    assert " on one core, 0.0" in shown

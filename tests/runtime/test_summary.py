"""The tally of a run against sums over the whole."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.cli.run_lines import beam_lines, traffic_lines
from lidar_emu.receiver.returns import FalseTarget
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, Pace
from lidar_emu.runtime.summary import Tally
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_in_blocks


def test_counts_of_shots_and_of_their_errors():
    scenario = load(
        "descent.yaml",
        {"instrument": "ndl_as_published", "duration_s": "5", "scanner.pattern.angle_deg": "22.5"},
    )
    tally = Tally(Pace.WALL)
    for block in measure_in_blocks(build_model(scenario), 32):
        tally.add_measurement(block.part(0, 70 - int(block.shot[0])) if 64 <= block.shot[0] < 70 else block)
        if block.shot[0] >= 64:
            break
    statuses = [DeliveryStatus.LATE if shot % 10 == 0 else DeliveryStatus.SENT for shot in range(70)]
    for shot, status in enumerate(statuses):
        tally.add_report(
            DeliveryReport(
                shot,
                shot * 50_000_000,
                shot * 50_000_000 + 1000 * shot if status is DeliveryStatus.SENT else -1,
                status,
            )
        )
    reported = tally.to_json()
    assert reported["shots"] == {
        "due": 70,
        "sent": 63,
        "late": 7,
        "suppressed": 0,
        "not_polled": 0,
        "dropped": {"full": 0, "nobody_connected": 0, "broken": 0},
    }
    assert reported["lateness"]["count"] == 63
    assert reported["lateness"]["max_ns"] == 69_000
    # At 20 Hz seconds of 20 shots and one of 10, lateness growing by 1 us a shot: the greatest of each second.
    assert reported["lateness"]["windows"] == {
        "count": 4,
        "p99_median_ns": pytest.approx(39_000, rel=1 / 128),
        "p99_worst_ns": 69_000,
        "worst_at_s": 3,
    }
    assert reported["beams"] == [{"valid": 70}] * 4
    run = simulate(scenario)
    error = (run.range_m - run.true_range_m)[:70]
    expected = {
        "count": 280,
        "mean": error.mean(),
        "rms": np.sqrt((error**2).mean()),
        "max": np.abs(error).max(),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(reported["range_error_m"][name], value, rtol=1e-12, err_msg=name)


def test_false_targets_are_counted_among_valid_measurements():
    run = simulate(load("dust_storm", {"duration_s": "2"}))
    tally = Tally(Pace.MAX)
    for block in (run.part(0, 7), run.part(7, len(run))):
        tally.add_measurement(block)
    reported = tally.to_json()
    of_haze = int(np.count_nonzero(run.range_valid & (run.true_peak_source == FalseTarget.HAZE)))
    assert of_haze > 50
    assert reported["false_targets"] == {"haze": of_haze}
    valid = sum(counts["valid"] for counts in reported["beams"])
    share = f"{100 * of_haze / valid:.1f}"
    assert beam_lines(reported)[-1] == f"false      haze in {share} % of valid measurements"


@pytest.mark.parametrize(
    ("unread", "lost"),
    [(0, ""), (12, "12 unread"), (4095, "at least 4095 unread"), (7099, "7099 unread")],
)
def test_bytes_behind_a_full_pty_are_not_counted_as_read(unread, lost):
    wire = {"sent_bytes": 9636, "load": 0.0, "unread_bytes": unread}
    events = {
        f"{kind}_event{part}": value
        for kind in ("link", "process")
        for part, value in (("s", []), ("_count", 0))
    }
    lines = traffic_lines({"wire": wire, "far_end": {}, **events})
    assert lines == ["wire       9636 bytes" + (lost and f", of which the host left {lost}")]


def test_pace_max_knows_no_lateness():
    tally = Tally(Pace.MAX)
    tally.add_report(DeliveryReport(0, 10_000_000, 5, DeliveryStatus.SENT))
    assert tally.to_json()["lateness"]["count"] == 0

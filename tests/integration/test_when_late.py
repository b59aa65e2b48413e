"""`timing.when_late`: what a late packet means for a run, by its command."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from lidar_emu.cli import cli
from lidar_emu.errors import RunError

# Nobody wakes up, decides and writes within a microsecond: every packet is late.
ALWAYS_LATE = ["--duration", "1", "--set", "level=geometric", "--set", "timing.late_after_s=1e-6"]
SHOTS_ALONE = ["--set", "device.housekeeping_rate_hz=0"]


@pytest.fixture
def run(tmp_path):
    def invoke(*arguments: str):
        summary = tmp_path / "summary.json"
        done = CliRunner().invoke(
            cli,
            ["run", "descent.yaml", *ALWAYS_LATE, *SHOTS_ALONE, "--summary", str(summary), *arguments],
            standalone_mode=False,
        )
        return done, json.loads(summary.read_text())

    return invoke


def test_a_late_packet_ends_a_run_that_wants_it_so(run):
    done, reported = run("--set", "timing.when_late=abort")
    assert isinstance(done.exception, RunError)  # exit code 1
    assert str(done.exception).startswith("shot 0 was ")
    assert "timing.when_late is abort" in str(done.exception)
    assert reported["error"] == str(done.exception)
    assert (reported["shots"]["due"], reported["shots"]["late"], reported["shots"]["sent"]) == (1, 1, 0)
    assert reported["wire"]["sent_bytes"] == 0
    assert reported["interrupted"] is False


def test_by_default_the_run_goes_on_to_its_end_and_states_that_it_sent_nothing(run):
    done, reported = run()
    assert isinstance(done.exception, RunError)
    assert str(done.exception) == "in-memory loopback: none of 20 shots was sent: 20 late"
    assert reported["error"] is None
    assert reported["shots"]["late"] == reported["shots"]["due"] == 20


def test_on_time_nothing_is_aborted(run):
    done, reported = run("--set", "timing.when_late=abort", "--set", "timing.late_after_s=3600")
    assert done.exception is None
    assert reported["error"] is None
    assert reported["shots"]["sent"] == 20

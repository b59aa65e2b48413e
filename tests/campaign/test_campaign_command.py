"""`lidar-emu campaign` as it is typed: results, plans, refusals, Ctrl-C and kill."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress

import pytest
from click.testing import CliRunner
from small_campaign import SMALL, content
from waiting import LIMIT_S

from lidar_emu.cli.campaign import campaign
from lidar_emu.errors import InputError, RunError

COMMAND = [sys.executable, "-m", "lidar_emu", "campaign"]


def run(*arguments):
    return CliRunner().invoke(campaign, [str(argument) for argument in arguments], catch_exceptions=True)


def refusal(*arguments):
    reported = run(*arguments).exception
    assert isinstance(reported, InputError), reported
    return str(reported)


@pytest.mark.slow
def test_tables_statistics_and_picture(campaign_file, tmp_path):
    out, plot = tmp_path / "out", tmp_path / "plot.png"
    done = run(campaign_file(), "--out", out, "--plot", plot, "--workers", 2, "--json")
    assert done.exit_code == 0, done.output
    reported = json.loads(done.stdout)
    assert (reported["runs"], reported["failed"], reported["reasons"]) == (12, 0, {})
    bands = [row for row in reported["statistics"] if row["axis"] == "altitude_m"]
    assert sum(row["expected"] for row in bands) == 12 * 8 * 4
    written = (out / "statistics.csv").read_text().splitlines()
    assert len(written) == 1 + len(reported["statistics"])
    assert plot.read_bytes().startswith(b"\x89PNG")
    before = content(out)
    again = run(campaign_file(), "--out", out)
    assert again.output.splitlines()[-1] == f"{out}: 12 runs, 0 failed"
    assert content(out) == before


@pytest.mark.slow
def test_the_plan_is_reported_and_nothing_kept(campaign_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = campaign_file(SMALL, 1000)
    reported = json.loads(run(path, "--plan", "--workers", 5, "--json").output)
    assert (reported["runs"], reported["workers"], reported["flown"]) == (1000, 5, 8)
    assert reported["hours"] == pytest.approx(1000 * reported["run_s"] / 5 / 3600)
    assert reported["flight_s"] == pytest.approx(0.4)
    assert 1e3 < reported["run_bytes"] < 1e5
    lines = run(path, "--plan").output
    assert "site.surface.reflectance: 0.1" in lines
    assert '"ndl_four_beam"' in lines
    assert list(tmp_path.iterdir()) == [path]


TIMING = "  timing: {kind: choice, of: [{rate_hz: 20}]}"
RATE = "  timing.rate_hz: {kind: uniform, low: 5, high: 9}"


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("runs: 12", "runs: 0", r"campaign.yaml: runs: must be greater than or equal to 1 \(got 0\)"),
        ("runs: 12", "", r"campaign.yaml: runs: missing"),
        ("kind: uniform", "kind: gauss", r"reflectance.kind: must be uniform, integer.* \(got 'gauss'\)"),
        ("seed: 5", "sampling: sobl", r"sampling: must be 'random'.* \(got 'sobl'\)"),
        ("low: 0.1, high: 0.3", "low: 0.3, high: 0.1", r"reflectance.high: must be above low, 0.3 \(got 0.1\)"),
        ("low: 0.1, high: 0.3", "low: .nan, high: 0.1", r"reflectance.low: must be a finite number \(got nan\)"),
        ("sigma: 60", "sigma: -60", r"sigma: must be greater than 0 \(got -60\)"),
        ("site.surface.reflectance:", "site.surface.reflectence:", "campaign: site.surface.reflectence"),
        ("waypoints.0.", "waypoints.9.", r"campaign: trajectory.waypoints.9.*must be an index from 0 to 2"),
        ("scenario: descent.yaml", "scenario: nowhere.yaml", "nowhere.yaml: no such file"),
        ("scenario: descent.yaml", "scenario: bench.yaml", "bench.yaml|campaign: "),
        ("site: flat,", "site.surface.reflectance: 0.2,", "site.surface.reflectance twice"),
        ("dispersions:", f"dispersions:\n{TIMING}\n{RATE}",
         "dispersions.timing.rate_hz: drawn beside timing; draw a key or keys below it"),
        ("dispersions:", f"dispersions:\n{RATE}\n{TIMING}", "dispersions.timing: drawn beside timing.rate_hz"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_reported(campaign_file, tmp_path, old, new, reported):
    text = SMALL.format(runs=12)
    assert old in text
    path = campaign_file()
    path.write_text(text.replace(old, new))
    line = refusal(path, "--out", tmp_path / "out")
    assert re.search(reported, line), line
    assert "\n" not in line
    assert not (tmp_path / "out").exists()


def test_keys_below_a_part_drawn_by_name_are_drawn_beside_it(campaign_file):
    power = "  instrument.optics.laser_power_w: {{kind: uniform, low: 1, high: 2}}"
    path = campaign_file(SMALL.replace("dispersions:", f"dispersions:\n{power}"))
    assert run(path, "--plan").exit_code == 0


@pytest.mark.parametrize("text", ["", "[]", "a", "name: x", "{}", "\0"])
def test_no_campaign_is_refused(tmp_path, text):
    (tmp_path / "c.yaml").write_text(text)
    assert str(tmp_path / "c.yaml") in refusal(tmp_path / "c.yaml", "--out", tmp_path / "out")


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        ([], "no output"),
        (["--out", "x", "--plan"], "--out and --plan"),
        (["--plan", "--workers", "0"], "--workers: must be a whole number above 0 (got '0')"),
        (["--plan", "--runs", "1e3"], "--runs: must be a whole number above 0 (got '1e3')"),
        (["--plan", "--runs", "20000000"], "--runs: must be less than or equal to 10000000 (got 20000000)"),
        (["--plan", "--set", "site.surface.reflectance=0.2"], "--set: site.surface.reflectance: drawn"),
        (["--plan", "--set", "level=quick"], "campaign: level: must be 'geometric', 'spectral'"),
        (["--plan", "--workers", "2", "--scheduler", "tcp://h:1"], "with --scheduler"),
        (["--out", "/proc/nothing"], "--out: /proc/nothing: "),
        (["--out", "x", "--plot", "x.jpg"], "x.jpg"),
    ],
)
def test_wrong_options_are_refused(campaign_file, arguments, reported):
    assert reported in refusal(campaign_file(), *arguments)


def test_a_campaign_none_of_whose_runs_can_be_flown_states_why(campaign_file):
    path = campaign_file(SMALL.replace("duration_s: 0.4", "duration_s: 4000"))
    reported = run(path, "--plan").exception
    assert isinstance(reported, RunError)
    assert "duration_s" in str(reported)


@pytest.fixture
def started(campaign_file, tmp_path):
    """A campaign of its own process group, ended at the latest with the test; and the wait for its first files."""
    processes = []

    def start():
        arguments = [str(campaign_file(SMALL, 3000)), "--out", str(tmp_path / "out"), "--workers", "2"]
        process = subprocess.Popen(
            [*COMMAND, *arguments],
            start_new_session=True,
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        while process.poll() is None and not any((tmp_path / "out" / "runs").glob("part-*")):
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.02)
        assert process.poll() is None, process.communicate()
        return process

    yield start
    for process in processes:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
def test_ctrl_c_ends_it_and_the_same_command_goes_on(started, tmp_path):
    process = started()
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of the group
    out, complaint = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, out) == (130, "")
    assert complaint.startswith("interrupted: ")
    assert len(complaint.strip().splitlines()) == 1
    kept = content(tmp_path / "out")
    assert not any("/." in name for name in kept)
    assert 1 <= len([name for name in kept if name.startswith("runs/")]) < 272
    following = started()
    assert {name: content(tmp_path / "out")[name] for name in kept} == kept
    following.kill()


@pytest.mark.slow
def test_workers_end_with_a_parent_that_was_killed(started):
    process = started()
    process.kill()
    process.wait()
    for _ in range(500):
        if not alive(process.pid):
            break
        with suppress(subprocess.TimeoutExpired):
            subprocess.run(["sleep", "0.02"], check=True)
    assert not alive(process.pid)

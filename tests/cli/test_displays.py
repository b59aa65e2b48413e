"""What is shown, and what goes on when nobody can be shown anything any more."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from installed_programs import LIDAR_EMU, with_programs
from waiting import LIMIT_S

from lidar_emu.api import simulate
from lidar_emu.cli.messages import ShotPrinter
from lidar_emu.cli.plan import plan
from lidar_emu.scenario.load import load
from lidar_emu.transports.messages import Decoder
from lidar_emu.wire import Encoder

QUICK = ("run", "bench.yaml", "--duration", "2", "--pace", "max")


def packets(unit: int, shots: int) -> list[bytes]:
    scenario = load("bench.yaml", {"wire.unit": str(unit)})
    encoder = Encoder(scenario.wire, can=False, fd=False, beam_count=4)
    return list(encoder.packets(simulate(scenario).part(0, shots)))


def lines_of(screen: ShotPrinter, stream: list[bytes], capsys: pytest.CaptureFixture[str]) -> list[str]:
    screen.show(Decoder().decode(b"".join(stream)))
    return [line for line in capsys.readouterr().out.splitlines() if "beam" not in line and "m/s" not in line]


def test_a_listener_shows_the_second_flight_as_well(capsys: pytest.CaptureFixture[str]) -> None:
    screen = ShotPrinter(every_s=0.0)
    assert len(lines_of(screen, packets(0, 5), capsys)) == 5
    assert len(lines_of(screen, packets(0, 3), capsys)) == 3


def test_units_do_not_hide_one_another(capsys: pytest.CaptureFixture[str]) -> None:
    mixed = [packet for pair in zip(packets(0, 20)[10:], packets(7, 10), strict=True) for packet in pair]
    lines = lines_of(ShotPrinter(every_s=0.5), mixed, capsys)
    # Ten shots at 10 Hz, one line each half second of each unit's own time.
    assert sorted(line.split()[1] for line in lines) == ["0", "0", "7", "7"]


@pytest.mark.slow
def test_a_reader_that_goes_away_does_not_end_the_flight(tmp_path: Path) -> None:
    run = subprocess.Popen([LIDAR_EMU, *QUICK, "--summary", "s.json"], cwd=tmp_path, stdout=subprocess.PIPE)
    assert run.stdout is not None
    run.stdout.readline()
    run.stdout.close()
    assert run.wait(LIMIT_S) == 0
    assert json.loads((tmp_path / "s.json").read_text())["shots"]["sent"] == 20


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_ends_the_recording_and_not_the_flight(tmp_path: Path) -> None:
    command = [LIDAR_EMU, *QUICK, "--summary", "s.json", "--record", "/dev/full"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "lidar-emu: /dev/full: the recording is incomplete: No space left on device\n"
    reported = json.loads((tmp_path / "s.json").read_text())
    assert reported["shots"]["sent"] == 20
    assert "incomplete" in reported["recording_error"]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_under_recording_and_summary_names_both(tmp_path: Path) -> None:
    command = [LIDAR_EMU, *QUICK, "--summary", "/dev/full", "--record", "/dev/full"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (
        1,
        "lidar-emu: /dev/full: the recording is incomplete: No space left on device; "
        "/dev/full: could not be written: No space left on device\n",
    )


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("how", ["--json", "--plain"])
def test_a_full_disk_under_standard_output_fails_the_run(how: str, tmp_path: Path) -> None:
    """The flight and its files are whole."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [LIDAR_EMU, *QUICK, how, "--summary", "s.json"],
            cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (1, "lidar-emu: standard output: No space left on device\n")
    assert json.loads((tmp_path / "s.json").read_text())["shots"]["sent"] == 20


def test_an_interrupted_run_proves_nothing(tmp_path: Path) -> None:
    """Cut short by SIGTERM: a clean end, but not what --fail-on asks for."""
    command = [LIDAR_EMU, "run", "bench.yaml", "--fail-on", "late", "--summary", "s.json"]
    run = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE)
    assert run.stdout is not None
    run.stdout.readline()
    run.terminate()
    run.communicate()
    assert run.returncode == 1
    assert json.loads((tmp_path / "s.json").read_text())["interrupted"] is True


@pytest.mark.parametrize(
    ("settings", "late", "dies"),
    [
        ([], "100 ms late is skipped", "the other one ends the run"),
        (
            ["timing.when_late=abort", "timing.late_after_s=0.002"],
            "2 ms late ends the run",
            "the other one ends the run",
        ),
        (["timing.when_process_dies=safe"], "100 ms late is skipped", "sends mode safe, and ends the run"),
    ],
)
def test_a_plan_reports_what_a_run_does_when_something_goes_wrong(
    settings: list[str], late: str, dies: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [word for setting in settings for word in ("--set", setting)]
    for as_json in ([], ["--json"]):
        plan.main(["bench.yaml", *options, *as_json], standalone_mode=False)
        reported = capsys.readouterr().out
        policies = (
            json.loads(reported)["policies"]
            if as_json
            else dict(line.split(": ") for line in reported.splitlines()[-2:])
        )
        assert policies["timing.when_late"].endswith(late)
        assert policies["timing.when_process_dies"].endswith(dies)


@pytest.mark.slow
def test_a_terminal_without_the_characters_shows_question_marks(tmp_path: Path) -> None:
    environment = with_programs(PYTHONIOENCODING="ascii")
    command = [LIDAR_EMU, "detection", "descent.yaml"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"?" in done.stdout
    assert done.stdout.isascii()

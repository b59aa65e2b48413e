"""`lidar-emu trial` with navigators that make known mistakes: each fails where it must, and the right one passes."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner, Result
from free_ports import free_udp_port

from lidar_emu.cli import cli, main
from lidar_emu.cli.trial import StatusLine
from lidar_emu.errors import InputError, RunError
from lidar_emu.trial.fly import Bench, Flown, fly
from lidar_emu.trial.grading import FIGURES, SERIES, Grade, Series, TrueMotion
from lidar_emu.trial.judge import cells, judge_case, junit_xml, try_case
from lidar_emu.trial.pack import PreparedCase, read_pack, shipped_packs
from lidar_emu.trial.solutions import Trust, from_columns, read_solutions

NAVIGATOR = Path(__file__).resolve().parents[1] / "support" / "navigator.py"
EXAMPLE = NAVIGATOR.parents[2] / "examples" / "navigation"
PACK = """
name: short
requirements:
  - {id: ALTITUDE, text: Altitudes are within 10 m., solution: altitude_error_m_abs, at_most: 10, share: 0.95}
  - {id: VELOCITY, text: Velocities are within 0.5 m/s., solution: velocity_error_mps_abs, at_most: 0.5, share: 0.95}
  - {id: AVAILABLE, text: Solutions are there., flight: available_share, at_least: 0.75}
  - {id: SIGMAS, text: Sigmas are right., flight: velocity_within_3_sigma, at_least: 0.9}
  - {id: DISTRUST, text: A wrong beam is distrusted within half a second., solution: distrust_s, at_most: 0.5}
cases:
  - id: biased
    question: Does it reject a beam with a false speed and range?
    scenario: descent.yaml
    set:
      site: flat
      duration_s: 6
      trajectory.waypoints: [{altitude_m: 400, speed_mps: 30}, {altitude_m: 100, speed_mps: 20}]
      faults: [{kind: bias, beams: [1], range_m: 60, closing_speed_mps: 8, from_s: 3, to_s: 5}]
"""
FAILED = {
    "none": set(),
    "perfect": set(),
    "frozen clock": {"ALTITUDE", "VELOCITY", "SIGMAS", "DISTRUST"},
    "sign of a beam": {"ALTITUDE", "VELOCITY", "SIGMAS", "DISTRUST"},
    "no gate": {"ALTITUDE", "VELOCITY", "SIGMAS", "DISTRUST"},
    "overconfident": {"SIGMAS"},
    "hangs": {"AVAILABLE", "DISTRUST"},
    "sends NaN": {"AVAILABLE", "DISTRUST"},
    "floods": set(),
}
"""Requirements that each navigator must miss. It is frozen, hangs or floods from two seconds on; the beam is wrong from
three on."""


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    folder = tmp_path / "short"
    folder.mkdir()
    (folder / "pack.yaml").write_text(PACK)
    return folder


def trial(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["trial", *map(str, arguments)], standalone_mode=False)


def host(mistake: str) -> str:
    words = [sys.executable, str(NAVIGATOR)]
    return f"{shlex.join(words)} {{scenario}} {{port}} {shlex.quote(mistake)}"


def failed(document: dict[str, Any]) -> set[str]:
    (case,) = document["cases"]
    return {one["id"] for one in case["requirements"] if one["verdict"] != "pass"}


@pytest.mark.slow
@pytest.mark.parametrize("mistake", FAILED)
def test_each_navigator_misses_what_it_must(mistake: str, pack: Path, tmp_path: Path) -> None:
    done = trial(pack, "--port", "pty", "--baud", 921_600, "--host", host(mistake), "--out", tmp_path / "out",
                 "--junit", tmp_path / "trial.xml", "--json")  # fmt: skip
    document = json.loads((tmp_path / "out" / "trial.json").read_text())
    assert failed(document) == FAILED[mistake], document
    assert done.return_value == (1 if FAILED[mistake] else 0)
    suite = ElementTree.parse(tmp_path / "trial.xml").getroot()[0]
    assert {
        case.get("name", "").partition(":")[0]
        for case in suite.iter("testcase")
        if case.find("failure") is not None
    } == FAILED[mistake]
    page = (tmp_path / "out" / "trial.html").read_text()
    assert ("biased: FAIL" if FAILED[mistake] else "biased: pass") in page
    assert "lidar-emu trial" in page


@pytest.mark.slow
@pytest.mark.parametrize("mistake", ["none", "no gate"])
def test_verdicts_over_udp_are_those_over_a_pty(mistake: str, pack: Path, tmp_path: Path) -> None:
    """The host runs before, as on the bench: nothing shows the device that it is there."""
    port = f"udp:127.0.0.1:{free_udp_port()}"
    flown = tmp_path / "flown.yaml"
    (case,) = read_pack(str(pack), []).cases
    flown.write_text(case.scenario.model_dump_json())
    command = [sys.executable, str(NAVIGATOR), str(flown), port, mistake]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as navigator:
        try:
            assert navigator.stdout is not None
            assert navigator.stdout.readline() == "ready\n"
            trial(pack, "--port", port, "--out", tmp_path / "out")
        finally:
            navigator.kill()
    assert failed(json.loads((tmp_path / "out" / "trial.json").read_text())) == FAILED[mistake]


@pytest.mark.slow
def test_a_host_that_fails_is_reported_with_its_last_line(pack: Path, tmp_path: Path) -> None:
    done = trial(pack, "--port", "pty", "--host", f"{sys.executable} -c 'raise OSError(\"no such line\")'",
                 "--out", tmp_path / "out")  # fmt: skip
    assert done.return_value == 1
    assert "the host ended with exit code 1: OSError: no such line" in done.output
    document = json.loads((tmp_path / "out" / "trial.json").read_text())
    assert len(failed(document)) == 5
    assert document["cases"][0]["flights"][0]["problem"].endswith("no such line")


def test_without_a_deception_there_is_nothing_to_judge(pack: Path) -> None:
    (case,) = read_pack(str(pack), []).cases
    quiet = Series(np.zeros(0), np.zeros(0))
    nowhere = TrueMotion(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    found = Grade(
        from_columns({"time_s": np.zeros(0)}), nowhere, np.zeros(0), nowhere, [], dict.fromkeys(SERIES, quiet),
        dict.fromkeys(FIGURES, 1.0), {},
    )  # fmt: skip
    verdict = judge_case(case, [Flown(case, 1, "again", found, "")])
    shown = {one.requirement.id: cells(one) for one in verdict.judged}
    assert shown["DISTRUST"] == ("nothing to judge", "at most 0.5", "1 of 1")
    assert shown["AVAILABLE"] == ("1", "at least 0.75", "1 of 1")
    assert shown["ALTITUDE"][0] == "no value"


def test_a_lack_of_flights_is_an_error_of_junit_and_a_miss_a_failure(pack: Path) -> None:
    """One flight cannot show 0.9 with 90 % confidence, by Clopper and Pearson: 22 are needed."""
    few = ", probability: 0.9"
    text = PACK.replace(
        "flight: available_share, at_least: 0.75", f"flight: available_share, at_least: 0.75{few}"
    )
    (pack / "pack.yaml").write_text(text)
    read = read_pack(str(pack), [])
    (case,) = read.cases
    series = {name: Series(np.zeros(1), np.zeros(1)) for name in SERIES}
    truth = TrueMotion(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1))
    found = Grade(
        from_columns({"time_s": np.zeros(1)}), truth, np.zeros(1), truth, [], series,
        dict.fromkeys(FIGURES, 1.0) | {"velocity_within_3_sigma": 0.5}, {},
    )  # fmt: skip
    root = ElementTree.fromstring(
        junit_xml(read, [judge_case(case, [Flown(case, 1, "again", found, "")])]).encode()
    )
    kinds = {each.get("name", "").partition(":")[0]: each[0] for each in root.iter("testcase")}
    assert [kinds[name].tag for name in ("ALTITUDE", "AVAILABLE", "SIGMAS")] == [
        "system-out",
        "error",
        "failure",
    ]
    assert kinds["AVAILABLE"].get("type") == "not enough runs"
    for element in (root, root[0]):
        assert [element.get(name) for name in ("tests", "failures", "errors")] == ["5", "1", "1"]


def test_cases_are_listed(pack: Path) -> None:
    done = trial(pack, "--list")
    assert done.exit_code == 0
    assert "biased: Does it reject a beam" in done.output
    assert "(1 flight of 6 s; " in done.output
    assert "1 cases, 1 flight: 6 s in real time" in done.output
    (row,) = json.loads(trial(pack, "--list", "--json").output)
    assert (row["id"], row["flight_s"]) == ("biased", 6)


def test_the_status_line_names_the_flights_in_hand_and_the_time_that_is_left() -> None:
    """Two of four equal flights at a time: the first pair took 60 s, and so will the second."""
    status = StatusLine([50, 50, 50, 50], begun_ns=0)
    status.begin("moon", 1, "in flight")
    status.begin("moon", 2, "starting")
    assert status.line(10) == "0 of 4 flown; moon, seed 1: in flight; moon, seed 2: starting"
    assert status.end("moon", 1, 50, 60 * 10**9) == 1
    assert status.end("moon", 2, 50, 60 * 10**9) == 2
    assert status.line(70 * 10**9) == "2 of 4 flown, 50 s left"
    unknown = StatusLine([50, None], begun_ns=0)
    unknown.end("moon", 1, 50, 60 * 10**9)
    assert unknown.line(60 * 10**9) == "1 of 2 flown"
    slow = StatusLine([50, 50], begun_ns=0)
    slow.end("moon", 1, 50, 104 * 10**9)
    assert slow.line(104 * 10**9) == "1 of 2 flown, 100 s left"


def test_an_interrupted_trial_says_what_it_has(
    pack: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def until_ctrl_c(planned: list[tuple[PreparedCase, int]], *on_way: Any) -> None:
        on_way[-1](Flown(*planned[0], "again", None, "no solution"))
        raise KeyboardInterrupt

    monkeypatch.setattr("lidar_emu.trial.fly.fly_all", until_ctrl_c)
    monkeypatch.setattr(sys, "argv", ["lidar-emu", "trial", str(pack), "--port", "pty", "--out", str(pack)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 130
    assert f"interrupted: 1 of 1 flights in {pack}, not judged" in capsys.readouterr().err


def fly_a_case(pack: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, start: Callable[..., Any]) -> Flown:
    """The flight of the pack's case with a host that ends at once, without a word."""
    monkeypatch.setattr("lidar_emu.trial.fly.start_emulator", start)
    bench = Bench(folder, [], "false", None, [], Event(), lambda *_: None)
    return fly(read_pack(str(pack), []).cases[0], 1, bench)


def test_a_flight_that_cannot_be_laid_out_or_starts_late_has_a_reason(
    pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nobody(*_: Any, **__: Any) -> None:
        raise RunError("pty: waited 60 s for a host to open it; --wait-limit S allows more")

    assert fly_a_case(pack, tmp_path, monkeypatch, nobody).problem == "pty: waited 60 s for a host to open it"
    (tmp_path / "taken").write_text("a file, as a disk that is full refuses the folder too")
    assert "taken" in fly_a_case(pack, tmp_path / "taken", monkeypatch, nobody).problem


def test_a_host_that_ends_silently_is_said_to_print_nothing(
    pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Flying:
        port, recording = "pty", tmp_path / "none.mcap"

        def __init__(self, *_: Any, **__: Any) -> None: ...

        def finish(self, _limit_s: float) -> None:
            raise TimeoutError

        def close(self) -> None: ...

    problem = fly_a_case(pack, tmp_path, monkeypatch, Flying).problem
    assert problem == "the host ended with exit code 1: no output"


@pytest.mark.parametrize("option", ["--out", "--new"])
def test_a_folder_that_cannot_be_made_is_refused(option: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    refused = trial("nominal", "--port", "pty", option, tmp_path / "file" / "below").exception
    assert isinstance(refused, InputError)
    assert str(refused).startswith(f"{option}: must be a folder; ")


@pytest.mark.slow
def test_a_seed_is_flown_again_by_the_command_of_the_page(pack: Path, tmp_path: Path) -> None:
    done = trial(pack, "--port", "pty", "--baud", 921_600, "--host", host("no gate"), "--out", tmp_path / "out",
                 "--only", "biased", "--seed", 7)  # fmt: skip
    assert done.return_value == 1
    assert "1 of 1: biased, seed 7" in done.output
    assert "0 of 1 cases pass" in done.output
    assert "biased misses ALTITUDE, VELOCITY" in done.output
    (flight,) = json.loads((tmp_path / "out" / "trial.json").read_text())["cases"][0]["flights"]
    program, *again = shlex.split(flight["command"])
    assert (program, flight["seed"]) == ("lidar-emu", 7)
    CliRunner().invoke(cli, again)
    repeated = json.loads((tmp_path / "out" / "again" / "trial.json").read_text())
    assert [each["seed"] for each in repeated["cases"][0]["flights"]] == [7]
    assert failed(repeated) == FAILED["no gate"]


@pytest.mark.parametrize("name", shipped_packs())
def test_a_shipped_pack_loads(name: str) -> None:
    pack = read_pack(name, [])
    assert len(pack.cases) >= 4
    assert all(one.requirements for one in pack.cases)


def test_a_pack_is_copied_to_be_changed(tmp_path: Path) -> None:
    copy = tmp_path / "mine"
    assert trial("nominal", "--new", copy).exit_code == 0
    assert trial(copy, "--list").output == trial("nominal", "--list").output
    assert isinstance(trial("nominal", "--new", copy).exception, InputError)


@pytest.mark.parametrize(
    ("changes", "arguments", "reported"),
    [
        ({}, ["--out", "out", "--only", "biassed"], "--only: "),
        ({}, [], "no output"),
        ({}, ["--out", "out", "--host", "nav {port}"], "no port"),
        ({}, ["--out", "out", "--port", "pty", "--seed", 2], "--seed: needs --only"),
        ({}, ["--out", "out", "--port", "pty", "--host", "nav {what}"], "--host: "),
        ({}, ["--out", "out", "--port", "pty", "--host", "'"], "--host: "),
        ({}, ["--out", "out", "--port", "pty", "--host", "no_such_program {port}"], "--host: "),
        ({}, ["--out", "out", "--solutions", "{x}.csv"], "--solutions: "),
        ({}, ["--out", "out", "--junit", "out.txt"], "--junit: "),
        ({}, ["--out", "out", "--port", "pty", "--jobs", 2], "--jobs: "),
        ({}, ["--out", "out", "--port", "pty:here", "--host", "nav", "--jobs", 2], "--jobs: "),
        ({"solution: distrust_s": "solution: distrust"}, ["--list"], "distrust_s"),
        ({"flight: available_share": "run: shots"}, ["--list"], "run"),
        ({"at_least: 0.75}": "at_least: 0.75, at_most: 1}"}, ["--list"], "state either at_most or at_least"),
        ({"id: biased": "id: Biased one"}, ["--list"], "cases.0.id"),
        ({"scenario: descent.yaml": "scenario: none.yaml"}, ["--list"], "none.yaml"),
        ({"duration_s: 6": "duration_s: -6"}, ["--list"], "duration_s"),
        ({"id: VELOCITY": "id: ALTITUDE"}, ["--list"], "stated once"),
    ],
)
def test_what_is_wrong_is_one_line(
    changes: dict[str, str],
    arguments: list[str],
    reported: str,
    pack: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    text = PACK
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new, 1)
    (pack / "pack.yaml").write_text(text)
    done = trial(pack, *arguments)
    assert isinstance(done.exception, Exception)
    assert reported in str(done.exception)
    assert "\n" not in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_a_log_is_read_and_a_bad_one_is_reported(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("time_s,altitude_m,range_trust_0,range_trust_1\n2,20,1,99\n1,10,gated,\n,5,1,1\n")
    stated = read_solutions(log)
    assert stated.time_s.tolist() == [1, 2]
    assert stated.altitude_m.tolist() == [10, 20]
    assert stated.range_trust.tolist() == [[Trust.GATED, Trust.NOT_JUDGED], [Trust.USED, Trust.NOT_JUDGED]]
    for text in ("", "time_s\n1\n", "a,b\n1,2\n", "time_s,altitude_m\n1,2,3\n", "time_s,altitude_m\n1,x\n"):
        log.write_text(text)
        with pytest.raises(InputError, match=r"log\.csv"):
            read_solutions(log)
    with pytest.raises(InputError):
        read_solutions(tmp_path / "none.csv")


@pytest.mark.slow
def test_a_test_asserts_the_verdict_on_a_case(pack: Path, tmp_path: Path) -> None:
    found = try_case(f"{pack}/biased", host("overconfident"), tmp_path, "--baud", "921600")
    assert not found.passes
    assert "SIGMAS: velocity_within_3_sigma" in str(found)
    assert "--only biased --seed 1" in str(found)
    assert "ALTITUDE" not in str(found)


def test_the_page_has_all_quantities() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "trial.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in page for name in (*SERIES, *FIGURES))


@pytest.mark.slow
def test_verdicts_over_can_are_those_over_a_pty(pack: Path, tmp_path: Path) -> None:
    group = f"239.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.253"  # no other test has it
    flown = tmp_path / "flown.yaml"
    (case,) = read_pack(str(pack), []).cases
    flown.write_text(case.scenario.model_dump_json())
    bus = ["-i", "udp_multicast", "-c", group]
    with subprocess.Popen(
        [sys.executable, "navigate.py", str(flown), *bus],
        cwd=EXAMPLE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as navigator:
        try:
            assert navigator.stderr is not None
            assert navigator.stderr.readline().startswith("listening on ")
            trial(pack, *bus, "--out", tmp_path / "out")
        finally:
            navigator.kill()
    navigate = shlex.join([sys.executable, str(EXAMPLE / "navigate.py")])
    trial(pack, "--port", "pty", "--baud", 921_600, "--out", tmp_path / "pty",
          "--host", f"{navigate} {{scenario}} --port {{port}}")  # fmt: skip
    found = [failed(json.loads((tmp_path / out / "trial.json").read_text())) for out in ("out", "pty")]
    # It begins 50 m and 1 m/s off, which the requirements do not excuse.
    assert found[0] == found[1] == {"ALTITUDE", "VELOCITY"}

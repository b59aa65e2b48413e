"""Flights of a trial: the emulated lidar on a port, the flight computer on the other end, and the grade afterwards."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from threading import Event
from typing import NamedTuple

from lidar_emu.errors import Finding, InputError, RunError, one_line
from lidar_emu.recording.channels import COMMAND, JsonReader
from lidar_emu.recording.read import read_recording
from lidar_emu.recording.readers import ShotReader
from lidar_emu.scene import build_scene
from lidar_emu.testing import LidarEmulator, start_emulator
from lidar_emu.trial.grading import Grade, grade
from lidar_emu.trial.pack import PreparedCase
from lidar_emu.trial.solutions import read_solutions, sent_solutions, trust_of_codes
from lidar_emu.wire import interface_named

_END_S = 10.0
"""Time for the host to end after a flight, and for a flight after its host."""
_POLL_S = 0.5
_LOG = "host.log"
"""File with the output of the host."""
_HANGS_S = 60.0
"""A host that flies the vehicle hangs if nothing is recorded for this long: without truth, time stands still."""
_PLACES = ("scenario", "seed", "port", "case", "truth")


class Bench(NamedTuple):
    """How a trial is flown."""

    folder: Path
    """Where recordings and outputs go, a folder for each flight."""
    port: list[str]
    """Options of `lidar-emu run` that choose port and pace."""
    host: str | None
    """Command that starts the flight computer, with `{scenario}` (a file with all that is set), `{seed}`, `{port}`,
    `{case}` and `{truth}` (where live truth is expected); None: it runs by itself."""
    log: str | None
    """Log of solutions with `{case}` and `{seed}`, which is graded; None: the messages that the navigation sent are."""
    again: list[str]
    """Command that repeats flights, but for `--only` and `--seed`."""
    stop: Event
    """Set to end the flights."""
    show: Callable[[PreparedCase, int, str], None]
    """Called from several threads with what the flight of a case and seed does: at each change, and while it flies."""


class Flown(NamedTuple):
    """A flight of a case."""

    case: PreparedCase
    seed: int
    command: str
    """The command that flies it again."""
    grade: Grade | None
    """None where the flight cannot be graded."""
    problem: str
    """Why there is no grade; empty where there is one."""


def check_host(host: str | None) -> None:
    """Check the command of a host.

    Raises:
        InputError: it is not a command, has another word in braces, or names no program.
    """
    if host is None:
        return
    try:
        words = _host_command(host, dict.fromkeys(_PLACES, "x"))
    except (ValueError, KeyError, IndexError):
        places = ", ".join(f"{{{name}}}" for name in _PLACES)
        raise InputError(
            "--host", None, host, f"must be a command with {places} and no other braces"
        ) from None
    if not words:
        raise InputError("--host", None, Finding("empty"), "must be a command")
    if shutil.which(words[0]) is None:
        raise InputError("--host", None, words[0], "must be a program that can be run")


def check_answers(cases: Sequence[PreparedCase]) -> None:
    """Check that the navigation messages of the cases' interfaces can be graded.

    Raises:
        InputError: see `trust_of_codes`.
    """
    for name, case in {one.scenario.wire.interface: one for one in cases}.items():
        trust_of_codes(interface_named(name, str(case.scenario_file), "wire.interface"), name)


def _host_command(host: str, places: dict[str, str]) -> list[str]:
    return [word.format(**places) for word in shlex.split(host)]


def fly(case: PreparedCase, seed: int, bench: Bench) -> Flown:
    """Fly a case once, and grade it; whatever the host does, there is a result."""
    folder = bench.folder / case.case.id / f"seed_{seed}"
    command = shlex.join([*bench.again, "--only", case.case.id, "--seed", str(seed)])
    flown = case.scenario.model_dump(mode="json") | {"seed": seed}
    try:  # from here on: a disk that is full must not end the trial, and lose the grades so far
        folder.mkdir(parents=True, exist_ok=True)
        (scenario := folder / "scenario.yaml").write_text(json.dumps(flown, indent=1), encoding="utf-8")
        (recording := folder / "flight.mcap").unlink(missing_ok=True)
        if bench.stop.is_set():
            raise RunError("interrupted")
        bench.show(case, seed, "starting")
        emulator = start_emulator(folder, scenario, None, arguments=bench.port)
        places = {"scenario": str(scenario), "seed": str(seed), "port": emulator.port, "case": case.case.id}
        live = case.scenario.live
        places["truth"] = "" if live is None else live.listen.removeprefix("udp:")
        with closing(emulator), _host(bench, places, folder) as host:
            show = partial(bench.show, case, seed, "in flight")
            _wait(emulator, host, folder, bench.stop, live is not None, show)
        bench.show(case, seed, "grading")
        found = grade_recording(recording, case, seed, bench.log)
    except (InputError, RunError, OSError) as error:
        problem = str(error).partition("; --wait-limit")[0]  # an option of run that a trial has not
        return Flown(case, seed, command, None, problem)
    return Flown(case, seed, command, found, "")


def grade_recording(path: Path, case: PreparedCase, seed: int, log: str | None) -> Grade:
    """Grade the flight of a recording.

    Args:
        path: the recording.
        case: the case that was flown.
        seed: its seed.
        log: see `Bench`.

    Raises:
        InputError: the recording, or the navigation's log, cannot be used.
    """
    recording = read_recording(path)
    shots = ShotReader(recording.damage)
    commands = JsonReader(recording.damage, recording.epoch_ns, [COMMAND])
    if log is None:
        answers = recording.host_message_reader()
        recording.read(shots, commands, answers)
        trusts = trust_of_codes(recording.interface, f"{path}: interface")
        stated = sent_solutions(answers.messages(), trusts)
    else:
        recording.read(shots, commands)
        stated = read_solutions(Path(log.format(case=case.case.id, seed=seed)))
    accepted = [one for one in commands.messages if one.values["verdict"] == "accepted"]
    commanded_s = {one.values["command"]: one.time_ns * 1e-9 for one in reversed(accepted)}
    height_m = build_scene(case.scenario.site).height_m
    return grade(shots.measurement(str(path)), height_m, stated, commanded_s)


def _wait(
    emulator: LidarEmulator,
    host: subprocess.Popen[bytes] | None,
    folder: Path,
    stop: Event,
    flies: bool,
    show: Callable[[], None],
) -> None:
    """Wait for the end of the flight.

    Args:
        flies: the host flies the vehicle: without it the flight has no end.

    Raises:
        RunError: the run failed, or the host hangs or ended too early, after which there is nothing to grade.
    """
    limit_s, size, quiet_s = _POLL_S, 0, 0.0
    while True:
        show()
        with suppress(TimeoutError):
            emulator.finish(limit_s)
            return
        if stop.is_set():
            raise RunError("interrupted")
        if host is None:
            continue
        if host.poll() or (flies and host.returncode == 0):
            if limit_s == _POLL_S:  # the end of the flight may have ended the host
                limit_s = _END_S
                continue
            last = (folder / _LOG).read_text(encoding="utf-8", errors="replace").strip().rpartition("\n")[2]
            early = "" if host.returncode else " before the last truth"
            raise RunError(
                one_line(f"the host ended with exit code {host.returncode}{early}: {last or 'no output'}")
            )
        before, size = size, emulator.recording.stat().st_size if emulator.recording.exists() else 0
        quiet_s = 0.0 if size > before else quiet_s + limit_s
        if flies and quiet_s >= _HANGS_S:
            raise RunError(f"no truth of the host for {_HANGS_S:g} s")


@contextmanager
def _host(bench: Bench, places: dict[str, str], folder: Path) -> Iterator[subprocess.Popen[bytes] | None]:
    """Run the host during the block."""
    if bench.host is None:
        yield None
        return
    command = _host_command(bench.host, places)
    with (folder / _LOG).open("wb") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )
        try:
            yield process
        finally:
            _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a host with all that it started."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, number)
        except ProcessLookupError:
            break
        try:
            process.wait(_END_S)
            break
        except subprocess.TimeoutExpired:
            continue
    process.wait()


def planned_flights(cases: Sequence[PreparedCase], seed: int | None = None) -> list[tuple[PreparedCase, int]]:
    """Cases and seeds to fly, in the order of the pack.

    Args:
        cases: the cases.
        seed: the only seed; None: all of the cases.
    """
    return [
        (case, each)
        for case in cases
        for each in (range(1, case.case.flights + 1) if seed is None else [seed])
    ]


def fly_all(
    planned: Sequence[tuple[PreparedCase, int]], bench: Bench, jobs: int, on_end: Callable[[Flown], None]
) -> list[Flown]:
    """Fly cases and seeds, `jobs` at a time; return them in this order.

    Args:
        planned: cases and seeds.
        bench: how they are flown.
        jobs: flights at a time.
        on_end: called with each flight when it is over.

    Raises:
        KeyboardInterrupt: Ctrl-C; all lidars and hosts have ended.
    """
    with ThreadPoolExecutor(jobs) as pool:
        flights = [pool.submit(fly, case, seed, bench) for case, seed in planned]
        try:
            for flight in as_completed(flights):
                on_end(flight.result())
        except BaseException:
            bench.stop.set()
            raise
    return [flight.result() for flight in flights]

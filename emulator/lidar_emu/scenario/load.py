"""Reading a scenario: files, mappings and changed keys, checked once, here.

A homodyne receiver observes a beat folded to the band up to half its sample rate. Such an instrument can be built, so
that it is not refused: it reports a wrong range or speed, as it would on the bench, without claiming that signs and
folds are resolved.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from lidar_emu.errors import Finding, InputError, did_you_mean, listed, nearest, warn_once
from lidar_emu.files import check_file, check_keeps, is_pipe, near_file
from lidar_emu.scenario.explain import Source, validated
from lidar_emu.scenario.faults import Fault, LinkFault, ScheduledFault
from lidar_emu.scenario.instrument import Waveform
from lidar_emu.scenario.parts import (
    OPTION,
    ChangedKey,
    changed_keys,
    checked,
    is_true,
    plain_mapping,
    shipped,
    shipped_names,
)
from lidar_emu.scenario.schema import BenchScenario, FlightScenario, Scenario
from lidar_emu.scenario.trajectory import Profile
from lidar_emu.scenario.yaml_text import Tree, parse, read_mapping


def ambiguities(scenario: FlightScenario | BenchScenario) -> list[str]:
    """Describe the ranges and speeds within the instrument's and the flight's limits that alias, a line for each."""
    if isinstance(scenario, BenchScenario):
        return []
    waveform, lines = scenario.instrument.waveform, []
    maximum_m = scenario.instrument.detection.maximum_range_m
    if maximum_m > waveform.nyquist_range_m:
        lines.append(
            f"instrument.detection.maximum_range_m: {maximum_m:g}: beats of ranges beyond "
            f"{waveform.nyquist_range_m:.6g} m exceed half the sample rate: {folded_range(waveform, maximum_m)}"
        )
    if isinstance(scenario.trajectory, Profile):
        fastest_mps = max(waypoint.speed_mps for waypoint in scenario.trajectory.waypoints)
        if fastest_mps > waveform.unambiguous_speed_mps:
            lines.append(
                f"trajectory.waypoints: {fastest_mps:g} m/s: closing speeds beyond "
                f"{waveform.unambiguous_speed_mps:.6g} m/s alias: {folded_speed(waveform, fastest_mps)}"
            )
    return lines


def folded_range(waveform: Waveform, range_m: float) -> str:
    """Describe what a range reads as in hover."""
    read_m = _folded(range_m, 2.0 * waveform.nyquist_range_m)
    return f"in hover {range_m:.6g} m reads as {abs(read_m):.6g} m"


def folded_speed(waveform: Waveform, speed_mps: float) -> str:
    """Describe what a closing speed reads as."""
    return f"{speed_mps:.6g} m/s reads as {_folded(speed_mps, 2.0 * waveform.unambiguous_speed_mps):.6g} m/s"


def _folded(value: float, period: float) -> float:
    """The alias of a value that lies nearest to 0."""
    return value - period * round(value / period)


_IN_PYTHON = "scenario"
_DESCRIPTORS = ("/dev", "/dev/fd", "/proc/self/fd")
"""Where `/dev/stdin` and the pipes of `<(command)` are."""


_FLOWN_BY = {
    "scenarios": ("a scenario", "fly it with lidar-emu run, or name it in a campaign"),
    "campaigns": ("a campaign", "fly it with lidar-emu campaign"),
}


def flown_otherwise(where: str, folder: str) -> InputError:
    """Error for a file of the kind that lies in this folder, where the other kind is needed."""
    what, remedy = _FLOWN_BY[folder]
    return InputError(where, None, Finding(what), remedy)


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that come with the package."""
    return shipped_names("scenarios")


ScenarioSource = str | PathLike[str] | Mapping[str, Any] | Scenario
"""What `load` takes: a path, the name of a shipped scenario, a mapping, or a scenario."""


def load(
    scenario: ScenarioSource, overrides: Mapping[str, Any] | None = None, **keys: Any
) -> FlightScenario | BenchScenario:
    """Read and check a scenario; warn of ranges and speeds that its instrument cannot tell from others.

    Args:
        scenario: path of a YAML file; the name of a shipped scenario (`descent.yaml` or `descent`); a mapping with
            the keys of a file; or a scenario, which is checked again.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`. Text is read as
            YAML, as on the command line: `{"site": "mare"}`, `{"faults": "[{kind: dropout, beams: [2]}]"}`.
        keys: the same for keys without a dot, e.g. `duration_s=5`.

    Files that a mapping or an override names are relative to the scenario's file, or to the working directory if the
    scenario is not from a file.

    Raises:
        InputError: one line that names the file or argument, the key, what it must be, and the value.
    """
    if isinstance(scenario, FlightScenario | BenchScenario):
        return _warned(scenario.with_(overrides, **keys), scenario.name)
    changes = changed_keys(overrides, keys)
    if isinstance(scenario, Mapping):
        return _checked(plain_mapping(scenario, _IN_PYTHON), changes, Path(), _IN_PYTHON)
    if not isinstance(scenario, str | PathLike):
        remedy = "must be a path, the name of a shipped scenario, a mapping, or a scenario"
        raise InputError(_IN_PYTHON, None, scenario, remedy)
    return read_scenario(Path(scenario), changes)


def load_with_settings(scenario: str, settings: Mapping[str, str]) -> FlightScenario | BenchScenario:
    """Read and check a scenario with dotted keys and YAML values from the command line, see `load`."""
    return read_scenario(Path(scenario), settings_to_changes(settings))


def settings_to_changes(settings: Mapping[str, str]) -> list[ChangedKey]:
    """The changes that dotted keys and YAML values from the command line state.

    Raises:
        InputError: a value is not YAML.
    """
    return [ChangedKey(key, parse(text, f"{OPTION} {key}"), OPTION) for key, text in settings.items()]


def read_scenario(scenario: Path, changes: list[ChangedKey]) -> FlightScenario | BenchScenario:
    """Read and check a scenario's file, or a shipped one's, with changed keys, see `load`."""
    path = find_file_or_pipe(scenario, "scenarios")
    owner = Path() if str(path.parent) in _DESCRIPTORS else path
    return _checked(read_mapping(path), changes, owner, str(path))


def _checked(
    tree: Tree, changes: list[ChangedKey], owner: Path, where: str
) -> FlightScenario | BenchScenario:
    if {"scenario", "runs"} <= tree.keys():
        raise flown_otherwise(where, "campaigns")
    stated = {*tree, *(change.key.partition(".")[0] for change in changes)}
    kind: type[FlightScenario | BenchScenario] = (
        BenchScenario if "bench_pattern" in stated else FlightScenario
    )
    return _warned(checked(tree, changes, kind, owner, where), Path(where).name)


def _warned(scenario: FlightScenario | BenchScenario, name: str) -> FlightScenario | BenchScenario:
    for line in ambiguities(scenario):
        warn_once(line, f"{name}: {line}")
    return scenario


def find_file_or_pipe(given: Path, folder: str) -> Path:
    """As `find_file`; a path of a pipe as well, as of `<(command)`, and `-` for the standard input.

    Raises:
        InputError: there is none.
    """
    found = Path("/dev/stdin") if str(given) == "-" else given
    return found if is_pipe(found) else find_file(found, folder)


def find_file(given: Path, folder: str) -> Path:
    """A file that the user names: its path, or the name of one that is shipped in `folder`.

    Raises:
        InputError: there is none.
    """
    if is_true(given.is_file):
        return given
    names = shipped_names(folder)
    if given.parent == Path():
        either = {given.name, given.name + ".yaml"}
        if found := either.intersection(names):
            return shipped(folder) / found.pop()
        for other in _FLOWN_BY:
            if either.intersection(shipped_names(other)):
                raise flown_otherwise(str(given), other)
    hint = did_you_mean(None if near_file(given) else nearest(f"{given.stem}.yaml", names, 0.85))
    check_file(given, f"{hint}name a YAML file, or one of those shipped: {listed(names)}")
    return given


def require_flight(scenario: FlightScenario | BenchScenario) -> FlightScenario:
    """The scenario, if it is a flight.

    Raises:
        InputError: it is a bench pattern.
    """
    if isinstance(scenario, BenchScenario):
        found = Finding("a bench pattern has no geometry")
        raise InputError(scenario.name, None, found, "name a flight, with an instrument and a site")
    return scenario


def require_known_flight(scenario: FlightScenario | BenchScenario) -> FlightScenario | BenchScenario:
    """The scenario, unless its truth is live: commands that cannot wait for a simulator refuse it.

    Raises:
        InputError: the trajectory is live.
    """
    if scenario.live is not None:
        remedy = "must be profile, table or powered_descent; live truth is flown by lidar-emu run"
        raise InputError(scenario.name, "trajectory.kind", "live", remedy)
    return scenario


_WHERE = "fault"
_Fault = ScheduledFault | LinkFault


class _Injection(BaseModel):
    fault: Fault
    """The fault; its times count from the first shot that it can affect."""


def read_fault(text: str) -> _Fault:
    """Read a fault injected in flight from a YAML mapping, as in a scenario.

    `lasts_s` without `probability` is the duration of the fault.

    Raises:
        InputError: names the key, what it must be, and the value.
    """
    tree = parse(text, _WHERE)
    if not isinstance(tree, dict):
        raise InputError(
            _WHERE, None, tree, "must be a mapping such as {kind: dropout, beams: [2], lasts_s: 2}"
        )
    if "lasts_s" in tree and not tree.keys() & {"probability", "at_s", "to_s"}:
        lasts_s, from_s = tree.pop("lasts_s"), tree.get("from_s", 0)
        whole = isinstance(lasts_s, int | float) and isinstance(from_s, int | float)
        if whole and not lasts_s > 0:
            raise InputError(_WHERE, "lasts_s", lasts_s, "must be greater than 0")
        tree["to_s"] = from_s + lasts_s if whole else lasts_s
    return validated(_Injection, {"fault": tree}, {(): Source(_WHERE, 1)}).fault


def shifted(fault: _Fault, by_s: float) -> _Fault:
    """Fault with all of its times shifted to later ones by `by_s`."""
    times_s = {
        name: getattr(fault, name) for name in ("at_s", "from_s", "to_s") if name in type(fault).model_fields
    }
    if times_s.get("at_s") is not None:
        del times_s["from_s"]
    later_s: dict[str, float] = {
        name: time_s + by_s for name, time_s in times_s.items() if time_s is not None
    }
    return fault.model_copy(update=later_s)


def hashed_files(scenario: FlightScenario | BenchScenario) -> Iterator[tuple[str, str]]:
    """Yield each file that the scenario names, with its SHA-256."""
    for name in sorted(_named_files(scenario.model_dump(mode="json"))):
        if Path(name).is_file():
            with Path(name).open("rb") as file:
                yield name, hashlib.file_digest(file, "sha256").hexdigest()


def check_keeps_files(
    scenario: FlightScenario | BenchScenario, written: Mapping[str, Sequence[str | None]]
) -> None:
    """Refuse to write over a file that the scenario names, such as a map, by the files that each option names.

    Raises:
        InputError: one of them is a file of the scenario; the error names the option.
    """
    for name in _named_files(scenario.model_dump(mode="json")):
        for option, files in written.items():
            for file in filter(None, files):
                check_keeps(Path(name), Path(file), option)


def _named_files(node: Any) -> set[str]:
    if isinstance(node, list):
        return set().union(*map(_named_files, node))
    if not isinstance(node, dict):
        return set()
    own = {node["file"]} if isinstance(node.get("file"), str) else set()
    return own.union(*map(_named_files, node.values()))

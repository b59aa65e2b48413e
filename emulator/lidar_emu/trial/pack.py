"""A pack of cases: a folder with scenarios and `pack.yaml`, which states what a navigation must do on each."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from lidar_emu.campaign.requirements import Requirement, Stated, refuse_repeated
from lidar_emu.errors import Finding, InputError, did_you_mean, listed, nearest
from lidar_emu.files import check_file
from lidar_emu.scenario.explain import Source, validated
from lidar_emu.scenario.load import read_scenario, require_flight
from lidar_emu.scenario.parts import CAMPAIGN, ChangedKey, is_true, shipped
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.section import Part, unusable
from lidar_emu.scenario.yaml_text import read_mapping
from lidar_emu.trial.grading import COMMANDED, FIGURES, SERIES

PACK_FILE = "pack.yaml"
_Id = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]{0,59}$")]


class TrialRequirement(Requirement):
    """A requirement on the solutions that a navigation states, or on a whole flight."""

    flight: str | None = None
    """Quantity of a flight, such as `touchdown_speed_mps` or `available_share`."""
    solution: str | None = None
    """Quantity of each solution or deception, such as `altitude_error_m_abs` or `distrust_s`."""
    command: str | None = None
    """Name of a command, such as `set_pattern`, for `flight: commanded_altitude_m`."""

    def _check(self) -> None:
        super()._check()
        if (self.command is None) == (self.flight == COMMANDED):
            raise unusable("command", self.command, f"stated with flight: {COMMANDED}, and only there")

    def _quantities(self) -> tuple[Stated, Stated]:
        return ("flight", self.flight, list(FIGURES)), ("solution", self.solution, list(SERIES))


class Case(Part):
    """A case: a scenario, the flights of it, and the question that it asks."""

    id: _Id
    """Name of the case: small letters, digits and underscores."""
    question: str
    """What the case asks of a navigation."""
    scenario: str
    """File of the scenario, relative to the pack, or the name of a shipped one."""
    set: dict[str, Any] = {}
    """Dotted keys that replace keys of the scenario."""
    flights: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of flights, of seeds 1, 2, 3 and so on."""
    known: str = ""
    """What is known of the event that the case plays, with its sources."""
    assumed: str = ""
    """What is assumed beyond that."""
    requirements: list[TrialRequirement] = []
    """Requirements of this case; they replace those of the pack of the same identifier."""


class PackFile(Part):
    """The file of a pack."""

    name: str
    """Name of the pack, for reports."""
    text: str = ""
    """What the pack tests."""
    requirements: list[TrialRequirement] = []
    """Requirements of all cases."""
    cases: Annotated[list[Case], Field(min_length=1, max_length=1000)]
    """The cases, in the order in which they are flown."""

    def _check(self) -> None:
        refuse_repeated("requirements", [one.id for one in self.requirements])
        refuse_repeated("cases", [case.id for case in self.cases])
        for i, case in enumerate(self.cases):
            refuse_repeated(f"cases.{i}.requirements", [one.id for one in case.requirements])
            if not (case.requirements or self.requirements):
                raise unusable(f"cases.{i}", Finding("no requirement"), "state one here or for the pack")


class PreparedCase(NamedTuple):
    """A case whose scenario has been read."""

    case: Case
    scenario_file: Path
    scenario: FlightScenario
    requirements: list[TrialRequirement]

    @property
    def flight_s(self) -> float | None:
        """Duration of a flight; None: a simulator decides."""
        from lidar_emu.beams.flight import build_trajectory, flown_s

        if self.scenario.live is not None and self.scenario.duration_s is None:
            return None
        trajectory = build_trajectory(self.scenario.trajectory, self.scenario.site.body.radius_m)
        return flown_s(self.scenario, trajectory)


class Pack(NamedTuple):
    """A pack whose scenarios have been read."""

    path: Path
    name: str
    text: str
    cases: list[PreparedCase]


def shipped_packs() -> list[str]:
    """Names of the packs that come with the package."""
    return sorted(path.parent.name for path in shipped("packs").glob(f"*/{PACK_FILE}"))


def find_pack(given: str) -> Path:
    """The file of a pack: of a folder, a file, or a shipped pack's name.

    Raises:
        InputError: there is none.
    """
    for path in (Path(given) / PACK_FILE, Path(given), shipped("packs") / given / PACK_FILE):
        if is_true(path.is_file):
            return path
    names = shipped_packs()
    hint = did_you_mean(nearest(given, names))
    check_file(Path(given), f"{hint}name a folder with {PACK_FILE}, or a shipped pack: {listed(names)}")
    return Path(given)


def read_pack(given: str, only: list[str]) -> Pack:
    """Read a pack with its scenarios.

    Args:
        given: a folder, the file in it, or the name of a shipped pack.
        only: identifiers of the cases to keep; none: all.

    Raises:
        InputError: names the file, the key, the value that cannot be used, and what can.
    """
    path = find_pack(given)
    stated = validated(PackFile, read_mapping(path), {(): Source(str(path))})
    known = [case.id for case in stated.cases]
    for name in only:
        if name not in known:
            hint = did_you_mean(nearest(name, known))
            raise InputError("--only", None, name, f"{hint}must be a case of the pack: {listed(known)}")
    kept = [case for case in stated.cases if not only or case.id in only]
    return Pack(path, stated.name, stated.text, [_prepared(case, stated, path) for case in kept])


def _prepared(case: Case, pack: PackFile, path: Path) -> PreparedCase:
    beside = path.parent / case.scenario
    file = beside if is_true(beside.is_file) else Path(case.scenario)
    changes = [ChangedKey(key, value, CAMPAIGN) for key, value in case.set.items()]
    own = {one.id for one in case.requirements}
    kept = [one for one in pack.requirements if one.id not in own]
    return PreparedCase(case, file, require_flight(read_scenario(file, changes)), [*kept, *case.requirements])

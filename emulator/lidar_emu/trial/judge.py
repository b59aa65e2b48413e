"""Verdicts of a trial: the requirements of each case over its flights, as JUnit XML and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

import numpy as np

from lidar_emu.campaign.requirements import RunValues, deciding_rank
from lidar_emu.campaign.verdict_files import JunitSuite, JunitTest, junit_text
from lidar_emu.campaign.verdicts import Judgement, judge
from lidar_emu.errors import one_line
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.trial.fly import Bench, Flown, check_answers, check_host, fly_all, planned_flights
from lidar_emu.trial.grading import SERIES, STALE_S, Grade, arrivals_s
from lidar_emu.trial.pack import Pack, PreparedCase, TrialRequirement, read_pack

_OF_DECEPTIONS = {"distrust_s", "recovery_s"}
_UNITS = {"m": " m", "mps": " m/s", "s": " s"}


class CaseVerdict(NamedTuple):
    """A case with its flights, and the verdict on each of its requirements."""

    case: PreparedCase
    flights: list[Flown]
    judged: list[Judgement]

    @property
    def passes(self) -> bool:
        return all(one.verdict == "pass" for one in self.judged)

    @property
    def shown_flight(self) -> Flown:
        """The flight with the worst miss of the first requirement that is missed; the first, where none is."""
        missed = next((one.missed[0].seed for one in self.judged if one.missed), self.flights[0].seed)
        return next(one for one in self.flights if one.seed == missed)

    @property
    def first_missed(self) -> TrialRequirement | None:
        judged = zip(self.case.requirements, self.judged, strict=True)
        return next((required for required, one in judged if one.verdict != "pass"), None)

    @property
    def miss(self) -> str:
        """What a failed verdict rests on: the problem of the flight, or the first requirement that is missed."""
        problem, missed = self.shown_flight.problem, [one for one in self.judged if one.verdict != "pass"]
        if problem or not missed:
            return problem
        first, others = missed[0].requirement, ", ".join(one.requirement.id for one in missed[1:])
        words = f"Required ({first.id}): {one_line(first.text)} Found: {_found(missed[0])}."
        return f"{words} Also missed: {others}." if others else words

    def __str__(self) -> str:
        """The requirements that are missed, with the commands that fly again."""
        lines = [f"{self.case.case.id}: {'pass' if self.passes else 'fail'}"]
        for one in self.judged:
            if one.verdict != "pass":
                lines += [
                    f"{one.requirement.id}: {described(one)}",
                    *(f"  {line}" for line in lines_of(one, self)),
                ]
        return "\n".join(lines)


def value_of(requirement: TrialRequirement, found: Grade | None) -> float:
    """The value of a flight that decides on a requirement: it keeps the limit if, and only if, the flight meets it.

    NaN, which misses it, where the navigation stated nothing that the requirement judges. Without a deception there is
    nothing to distrust, and a requirement on that is met.
    """
    if found is None:
        return np.nan
    if requirement.command is not None:
        return found.commanded_m.get(requirement.command, np.nan)
    if requirement.flight is not None:
        return found.figures[requirement.flight]
    series, inside = found.series[requirement.quantity], in_band(requirement, found)
    if _judges_nothing(requirement, found):
        return requirement.limit
    value = np.sort(requirement.sign * series.value[inside & ~np.isnan(series.value)])
    if not value.size:
        return np.nan
    rank = int(deciding_rank(requirement.share, np.array(value.size)))
    return requirement.sign * float(value[rank - 1])


def in_band(requirement: TrialRequirement, found: Grade) -> BoolArray:
    """Whether each value that a requirement on solutions judges lies in its altitudes."""
    altitude_m = found.series[requirement.quantity].altitude_m
    low_m, high_m = requirement.altitude_m or (-np.inf, np.inf)
    return np.asarray((altitude_m >= low_m) & (altitude_m <= high_m))


def _judges_nothing(requirement: TrialRequirement, found: Grade | None) -> bool:
    """Whether there is no deception that the navigation could have distrusted."""
    return (
        found is not None and requirement.quantity in _OF_DECEPTIONS and not in_band(requirement, found).any()
    )


def judge_case(case: PreparedCase, flights: list[Flown]) -> CaseVerdict:
    """Judge the requirements of a case by its flights; a flight without a grade misses all of them."""
    seeds = np.array([one.seed for one in flights], dtype=np.int64)
    judged = []
    for one in case.requirements:
        values = np.array([value_of(one, each.grade) for each in flights])
        judgement = judge(one, RunValues(np.arange(len(flights)), seeds, values))
        nothing = all(_judges_nothing(one, each.grade) for each in flights)
        judged.append(judgement._replace(bound=None) if nothing else judgement)
    return CaseVerdict(case, flights, judged)


def _shown(quantity: str, value: float | None) -> str:
    if value is None:
        return "never" if quantity in _OF_DECEPTIONS else "no value"
    return f"{round(value, 6):.4g}"  # times of validity are rounded


def cells(judgement: Judgement) -> tuple[str, str, str]:
    """The worst value, the limit, and how many flights met it."""
    requirement, misses = judgement.requirement, len(judgement.missed)
    side = "at most" if requirement.at_most is not None else "at least"
    worst = judgement.missed[0].value if misses else judgement.bound
    # Where no flight has anything to judge, the value is the limit itself, which is no result.
    value = "nothing to judge" if worst is None and not misses else _shown(requirement.quantity, worst)
    return value, f"{side} {requirement.limit:g}", f"{judgement.runs - misses} of {judgement.runs}"


def _found(judgement: Judgement) -> str:
    """The worst value with its unit; a share in percent."""
    value, _, _ = cells(judgement)
    quantity = judgement.requirement.quantity.removesuffix("_abs")
    if not value[-1].isdigit():
        return value
    if quantity.endswith("_share") or "_within_" in quantity:
        return f"{100 * float(value):.3g} %"
    value += _UNITS.get(quantity.rpartition("_")[2], "")
    is_quantile = judgement.requirement.quantity in SERIES and judgement.requirement.at_most is not None
    return f"{100 * judgement.requirement.share:g} % within {value}" if is_quantile else value


def missed_spans(requirement: TrialRequirement, found: Grade) -> list[tuple[float, float]]:
    """Begin and duration of each time in which solutions miss a requirement on errors, sigmas or availability."""
    quantity = requirement.quantity
    if quantity in ("available_share", "longest_gap_s"):
        at_s = arrivals_s(found.stated, found.flight_s[0], found.flight_s[-1])
        allowed_s = STALE_S if quantity == "available_share" else requirement.limit
        begin_s, more_s = at_s[:-1] + allowed_s, np.diff(at_s) - allowed_s
        return list(zip(begin_s[more_s > 0].tolist(), more_s[more_s > 0].tolist(), strict=True))
    if "_within_" in quantity:
        kind, _, sigmas, _ = quantity.split("_")
        error, sigma = found.errors(kind)
        missed = np.any(np.abs(error) > float(sigmas) * np.where(sigma > 0, sigma, np.inf), axis=1)
    elif requirement.solution is not None and quantity not in _OF_DECEPTIONS:
        value = requirement.sign * found.series[quantity].value
        missed = in_band(requirement, found) & (value > requirement.sign * requirement.limit)
    else:
        return []
    return spans(found.stated.time_s, missed)


def spans(time_s: FloatArray, which: BoolArray) -> list[tuple[float, float]]:
    """Begin and duration of each run of solutions, up to the solution that follows it."""
    edges = np.diff(which.astype(np.int8), prepend=0, append=0)
    ends_s = np.append(time_s, time_s[-1:])
    begin_s, end_s = ends_s[np.flatnonzero(edges == 1)], ends_s[np.flatnonzero(edges == -1)]
    return list(zip(begin_s.tolist(), (end_s - begin_s).tolist(), strict=True))


def described(judgement: Judgement) -> str:
    """A verdict in one line."""
    value, limit, met = cells(judgement)
    return f"{judgement.requirement.quantity} {value}, {limit}: {met} flights"


def junit_xml(pack: Pack, verdicts: Sequence[CaseVerdict]) -> str:
    """JUnit XML as CI systems read it: a suite per case, a test per requirement; a lack of flights is an error."""
    suites = [
        JunitSuite(one.case.case.id, {}, [_junit_test(each, one) for each in one.judged]) for one in verdicts
    ]
    return junit_text(one_line(pack.name), suites)


def _junit_test(judgement: Judgement, verdict: CaseVerdict) -> JunitTest:
    problem = next((each.problem for each in verdict.flights if each.problem), described(judgement))
    return JunitTest(judgement, problem, lines_of(judgement, verdict))


def lines_of(judgement: Judgement, verdict: CaseVerdict) -> list[str]:
    """The flights that miss a requirement, each with the command that flies it again."""
    flights = {one.seed: one for one in verdict.flights}
    lines = []
    for miss in judgement.missed:
        flown = flights[miss.seed]
        value = flown.problem or _shown(judgement.requirement.quantity, miss.value)
        lines.append(one_line(f"seed {miss.seed}, {value}: {flown.command}"))
    return lines


def document(pack: Pack, verdicts: Sequence[CaseVerdict]) -> dict[str, Any]:
    """The trial as JSON values."""
    return {
        "pack": pack.name,
        "passes": all(one.passes for one in verdicts),
        "cases": [
            {
                "id": one.case.case.id,
                "passes": one.passes,
                "requirements": [
                    {**each.document(), "text": each.requirement.text, "shown": described(each)}
                    for each in one.judged
                ],
                "flights": [
                    {
                        "seed": flown.seed,
                        "problem": flown.problem or None,
                        "command": flown.command,
                        "figures": _known(flown.grade),
                    }
                    for flown in one.flights
                ],
            }
            for one in verdicts
        ],
    }


def _known(found: Grade | None) -> dict[str, float | None]:
    figures = {} if found is None else found.figures
    return {name: value if np.isfinite(value) else None for name, value in figures.items()}


def try_case(name: str, host: str, folder: Path, *options: str) -> CaseVerdict:
    """Fly one case on a pty, and judge it.

    Args:
        name: pack and case, such as `nominal/moon`; the pack may be the path of a folder.
        host: command that starts the flight computer, see `Bench`.
        folder: where recordings go.
        options: further options of `lidar-emu trial`, of the port and its pace, such as `--baud`, `921600`.

    Raises:
        InputError: there is no such case, it cannot be used, or the command or the interface cannot.
    """
    pack, _, case = name.rpartition("/")
    (prepared,) = read_pack(pack, [case]).cases
    check_host(host)
    check_answers([prepared])
    port = ["--port", "pty", *options]
    again = ["lidar-emu", "trial", pack, *port, "--host", host, "--out", "again"]
    bench = Bench(folder, port, host, None, again, Event(), lambda *_: None)
    return judge_case(prepared, fly_all(planned_flights([prepared]), bench, 1, lambda _: None))

"""An instrument at the extremes of its keys and of its flight: what is refused, what fails, and how far errors grow."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from math import inf, nextafter
from typing import Any, Literal, NamedTuple

import numpy as np

from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.receiver.returns import Reason, Returns
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.section import Part, limits_of
from lidar_emu.shots.model import build_model

LevelName = Literal["geometric", "spectral", "reference"]
SHOTS: dict[LevelName, int] = {"geometric": 40, "spectral": 40, "reference": 4}
"""Shots of each extreme for four beams, fewer for more; a shot of the reference takes as long as a thousand others."""

Verdict = Literal["refused", "unsound", "nothing valid", "degraded", "as before"]
_GROWN, _FEWER, _ROUNDING = 2.0, 0.05, 1e-9
_USUAL_HEIGHT = 0.05
"""Height of the flights where nothing else is extreme, as a share of the maximum range."""


class Extreme(NamedTuple):
    """Changes of a scenario, by dotted keys."""

    name: str
    keys: dict[str, Any]
    safe: bool = True
    """Flown at level reference too, which would take all memory for a footprint of kilometres."""


class ExtremeOutcome(NamedTuple):
    """What a level makes of an extreme; errors are of valid beams whose sign is resolved, if there are any."""

    refused: str | None
    """The error that names the key; None: it was flown."""
    reasons: dict[str, int] = {}
    """Beams by reason."""
    sign_resolved: float = np.nan
    """Share of the valid beams."""
    range_rms_m: float = np.nan
    """Against the truth at the time of validity, with the errors by motion within a measurement."""
    range_largest_m: float = np.nan
    speed_rms_mps: float = np.nan
    """Modulo λ fs/2: closing speeds that differ by it have the same beats."""
    speed_largest_mps: float = np.nan
    unsound: tuple[str, ...] = ()
    """What must not be reported whatever comes in."""

    @property
    def valid(self) -> float:
        """Share of the beams that fired."""
        return self.reasons.get("valid", 0) / max(1, sum(self.reasons.values()))

    def verdict(self, usual: ExtremeOutcome) -> Verdict:
        """Compare with the flight over level ground: degraded is twice the error, or 5 % fewer valid beams."""
        if self.refused is not None:
            return "refused"
        if self.unsound:
            return "unsound"
        if self.valid == 0.0:
            return "nothing valid"
        errors = (self.range_rms_m, usual.range_rms_m), (self.speed_rms_mps, usual.speed_rms_mps)
        grown = any(error > _GROWN * before + _ROUNDING for error, before in errors)
        return "degraded" if grown or self.valid < usual.valid - _FEWER else "as before"

    def to_json(self, usual: ExtremeOutcome) -> dict[str, Any]:
        """Convert to JSON values, None where there is no value, with the verdict."""
        values = {name: value if value == value else None for name, value in self._asdict().items()}
        return {"verdict": self.verdict(usual), "valid": self.valid} | values


def over_level_ground(height_m: float, speeds_mps: tuple[float, float], duration_s: float) -> dict[str, Any]:
    """Keys of a flight straight down to a height, at a speed that changes steadily from the first to the second."""
    start_m = height_m + 0.5 * sum(speeds_mps) * duration_s
    waypoints = [
        {"altitude_m": altitude_m, "speed_mps": speed_mps}
        for altitude_m, speed_mps in zip((start_m, height_m), speeds_mps, strict=True)
    ]
    return {
        "trajectory": {"kind": "profile", "waypoints": waypoints},
        "site.ground": {"kind": "plane"},
        "site.objects": [],
        "faults": [],
        "duration_s": None,
    }


def extremes(scenario: FlightScenario, height_m: float) -> list[Extreme]:
    """List the extremes of a scenario's flight and of each number of its instrument; the first is none.

    Args:
        scenario: its instrument, beams, surface and air stay as they are.
        height_m: height of the flight over level ground, where nothing else is extreme.
    """
    flights = _flights(scenario, height_m)
    usual = flights["level ground"]
    if scenario.live is None:
        flights["the scenario's own last shots"] = {}
    keys = [(key, value) for key, ends in numbers(scenario.instrument, "instrument") for value in ends]
    return [
        *(Extreme(name, changes) for name, changes in flights.items()),
        Extreme("height 1e6 m", usual | over_level_ground(1e6, (1.0, 1.0), 1.0), safe=False),
        *(
            Extreme(f"{k.rpartition('.')[2]} {value:.4g}", usual | {k: value}, safe=False)
            for k, value in keys
        ),
    ]


def _flights(scenario: FlightScenario, height_m: float) -> dict[str, dict[str, Any]]:
    furthest_m = scenario.instrument.detection.maximum_range_m
    fastest_mps = scenario.instrument.waveform.unambiguous_speed_mps
    usual_mps, slow_mps = 0.1 * fastest_mps, 0.002 * fastest_mps
    rate_hz = scenario.timing.rate_hz
    flown_s, brief_s = SHOTS["spectral"] / rate_hz, SHOTS["reference"] / rate_hz
    # As many shots of a fast flight as of a slow one, at nearly one height.
    quick_hz = 0.9 / scenario.cycle_time_s
    quick_s = SHOTS["spectral"] / quick_hz
    usual = over_level_ground(height_m, (usual_mps, usual_mps), flown_s)
    long = over_level_ground(height_m, (slow_mps, slow_mps), min(864e3, 9e6 / slow_mps))
    flights = {"level ground": usual, "10 days": long | {"timing.rate_hz": 0.1}}
    for speed_mps in (1e-9, *(share * fastest_mps for share in (0.999, 1.0, 1.5, 2.5))):
        fast = over_level_ground(height_m, (speed_mps, speed_mps), quick_s)
        flights[f"speed {speed_mps:.4g} m/s"] = fast | {"timing.rate_hz": quick_hz}
    for low_m in (0.0, 0.01, 1.0, 0.9 * furthest_m, 1.01 * furthest_m):
        flights[f"height {low_m:g} m"] = over_level_ground(low_m, (slow_mps, slow_mps), brief_s)
    for braking_mps2 in (30.0, 1000.0):
        speeds_mps = usual_mps + braking_mps2 * brief_s, usual_mps
        flights[f"braking by {braking_mps2:g} m/s²"] = over_level_ground(height_m, speeds_mps, brief_s)
    for slope_deg in (60.0, 80.0, 89.0):
        flights[f"slope {slope_deg:g}°"] = usual | {"site.ground": {"kind": "plane", "slope_deg": slope_deg}}
    for turn in ((1.0, -1.0, 1.0), (0.0, 0.0, 5.0)):
        name = f"turn of {' '.join(f'{rate:g}' for rate in turn)} rad/s"
        flights[name] = usual | {"trajectory.attitude.body_rate_radps": turn}
    flights["beams to the sky"] = usual | {"trajectory.attitude.roll_deg": 180.0}
    for width_hz in (1e4, 1e5, 1e6):
        flights[f"linewidth {width_hz:g} Hz"] = usual | {"instrument.waveform.linewidth_hz": width_hz}
    for share in (0.0, 1.0):
        flights[f"reflectance {share:g}"] = usual | {"site.surface.reflectance": share}
    return flights


def numbers(part: Part, path: str) -> Iterator[tuple[str, list[float]]]:
    """Yield the dotted keys of the numbers of a part and its parts, with the least and the largest value of each."""
    limits = limits_of(type(part))
    for name, stated in type(part).model_json_schema()["properties"].items():
        value = getattr(part, name)
        if isinstance(value, Part):
            yield from numbers(value, f"{path}.{name}")
            continue
        most = limits[name].largest if name in limits else sys.float_info.max
        for kind in stated.get("anyOf", [stated]):
            if kind.get("type") not in ("number", "integer"):
                continue
            choices = kind.get("enum", [-most, most])
            above, below = kind.get("exclusiveMinimum", -inf), kind.get("exclusiveMaximum", inf)
            least = kind.get("minimum", max(nextafter(above, inf), min(choices)))
            largest = kind.get("maximum", min(nextafter(below, -inf), max(choices)))
            yield f"{path}.{name}", [least, largest]


def measure_stability(scenario: FlightScenario, progress: Callable[[str], None]) -> Iterator[dict[str, Any]]:
    """Yield a row of JSON values for each extreme, as they are measured; the first is none.

    Args:
        scenario: a flight; of live truth its instrument, beams, surface and air alone.
        progress: takes what is measured now.
    """
    found = extremes(scenario, _USUAL_HEIGHT * scenario.instrument.detection.maximum_range_m)
    usual: dict[LevelName, ExtremeOutcome] = {}
    for place, extreme in enumerate(found, start=1):
        row = {}
        for level in SHOTS:
            if extreme.safe or level != "reference":
                progress(f"{place} of {len(found)}: {extreme.name}, {level}")
                outcome = measure(scenario, extreme, level)
                row[level] = outcome.to_json(usual.setdefault(level, outcome))
        yield {"extreme": extreme.name, "levels": row}


def measure(scenario: FlightScenario, extreme: Extreme, level: LevelName) -> ExtremeOutcome:
    """Fly an extreme of a scenario at a level: its last shots."""
    try:
        flown = scenario.with_(extreme.keys | {"level": level})
        model = build_model(flown)
        count = min(max(1, 4 * SHOTS[level] // model.beam_count), model.shot_count)
        run, _ = model.measure(model.shot_count - count, count, model.initial_state)
    except InputError as error:
        return ExtremeOutcome(f"{error.key}: {error.remedy}")
    except (ArithmeticError, MemoryError, ValueError) as error:
        return ExtremeOutcome(None, unsound=(f"{type(error).__name__}: {error}",))
    return _outcome(run, flown)


def _outcome(run: Measurement, scenario: FlightScenario) -> ExtremeOutcome:
    instrument, fired = scenario.instrument, run.fired
    reasons = [Reason(int(code)).name.lower() for code in run.reason[fired]]
    valid, resolved = run.range_valid & fired, run.range_valid & run.sign_resolved & fired
    judged = resolved if resolved.any() else valid
    cycle_mps = 2.0 * instrument.waveform.unambiguous_speed_mps
    speed_mps = (run.closing_speed_mps - run.true_closing_speed_mps)[judged]
    speed_mps -= cycle_mps * np.round(speed_mps / cycle_mps)
    return ExtremeOutcome(
        None,
        dict(Counter(reasons)),
        float(resolved.sum() / max(1, int(valid.sum()))),
        *_sizes((run.range_m - run.true_range_m)[judged]),
        *_sizes(speed_mps),
        tuple(violations(run, instrument.detection.maximum_range_m, scenario.level == "geometric")),
    )


def _sizes(errors: FloatArray) -> tuple[float, float]:
    if not errors.size:
        return np.nan, np.nan
    return float(np.sqrt(np.mean(errors**2))), float(np.max(np.abs(errors)))


def violations(
    report: Returns | Measurement, maximum_range_m: float, is_truth: bool = False
) -> Iterator[str]:
    """Yield what must not be reported: valid values that are no numbers, infinite or negative; unknown reasons.

    Args:
        report: what is reported.
        maximum_range_m: of the instrument.
        is_truth: the truth is reported, whose sigmas are 0 and whose SNR is unknown.
    """
    valid = report.reason == Reason.VALID
    if not np.isin(report.reason, [int(reason) for reason in Reason]).all():
        yield "an unknown reason"
    for name in ("range_valid", "speed_valid"):
        if not np.array_equal(getattr(report, name), valid):
            yield f"{name} and reason disagree"
    for name in ("range_m", "closing_speed_mps", "sigma_range_m", "sigma_speed_mps"):
        if not np.array_equal(np.isfinite(getattr(report, name)), valid):
            yield f"{name} is not a number where valid, or a number where not"
    for name in ("range_m", "closing_speed_mps", "snr_db", "residual_mps", "second_range_m"):
        if np.isinf(getattr(report, name)).any():
            yield f"{name} is infinite"
    for name in () if is_truth else ("sigma_range_m", "sigma_speed_mps"):
        if not (getattr(report, name)[valid] > 0.0).all():
            yield f"{name} is not positive"
    if not is_truth and not np.isfinite(report.snr_db[valid]).all():
        yield "snr_db is not a number where valid"
    for name in ("range_m", "second_range_m"):
        measured = getattr(report, name)
        if ((measured < 0.0) | (measured > maximum_range_m)).any():
            yield f"{name} is negative, or beyond maximum_range_m"

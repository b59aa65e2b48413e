"""Which effect exists at which level: the one place that decides it.

Validators, faults, plan and the table in `docs/evidence/accuracy.md` follow this list.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple, Protocol, cast

GEOMETRIC, SPECTRAL, REFERENCE = "geometric", "spectral", "reference"
FULL_RATE = "reference, full rate"
"""Level `reference` with `reference_samples: full_rate`."""

COLUMNS = GEOMETRIC, SPECTRAL, REFERENCE, FULL_RATE
_REFERENCES = REFERENCE, FULL_RATE
_RECEIVERS = SPECTRAL, *_REFERENCES


class _Levelled(Protocol):
    @property
    def level(self) -> str: ...

    @property
    def reference_samples(self) -> str: ...


class Effect(NamedTuple):
    """An effect, a way to measure, or a fault, with the levels that have it."""

    name: str
    levels: tuple[str, ...]
    key: str = ""
    """Dotted key that asks for it; empty: nothing refuses it, other levels are without it."""
    without: tuple[Any, ...] = ()
    """Values of the key that do not ask for it."""
    remedy: str = ""
    """What the key must be at other levels that measure."""


EFFECTS = (
    Effect("noise, false alarms, frequency response", _RECEIVERS),
    Effect("speckle", _RECEIVERS),
    Effect("steady echoes", (SPECTRAL,), "instrument.optics.speckle", (True,), "on"),
    Effect("laser line, sweep errors, smear, ripple", _RECEIVERS),
    Effect("several looks", (SPECTRAL,), "instrument.detection.looks", (1,), "1"),
    Effect("two of three segments", (SPECTRAL,), "instrument.detection.rule", ("all_three",), "all_three"),
    Effect(
        "parabola and jacobsen peaks",
        (SPECTRAL,),
        "instrument.detection.peak",
        ("bin", "hann", "aboutanios_mulgrew"),
        "bin, hann or aboutanios_mulgrew",
    ),
    Effect("back-reflection", _RECEIVERS),
    Effect("leakage between beams", _RECEIVERS),
    Effect("vibration", _RECEIVERS),
    Effect("clipping", (SPECTRAL, FULL_RATE)),
    Effect("haze and dust: extinction, streaks, their own light", _RECEIVERS),
    Effect("custom detector, spectra of a shot", _RECEIVERS),
    Effect("samples of a shot", (FULL_RATE,)),
    Effect("recorded geometry", (GEOMETRIC, SPECTRAL)),
    Effect("fault misalignment", COLUMNS),
    Effect("fault laser_fade", (SPECTRAL,)),
    Effect("fault reflectance_patch", (SPECTRAL,)),
    Effect("fault clutter", (SPECTRAL,)),
    Effect("fault missing_segment", (SPECTRAL,)),
    Effect("fault wrong_branch", (SPECTRAL,)),
    Effect("fault alias", (SPECTRAL,)),
    Effect("fault false_alarms", (SPECTRAL,)),
)

_BY_NAME = {effect.name: effect for effect in EFFECTS}


def column_of(scenario: _Levelled) -> str:
    """One of COLUMNS: the level, with its samples."""
    full_rate = scenario.level == REFERENCE and scenario.reference_samples == "full_rate"
    return FULL_RATE if full_rate else scenario.level


def has_effect(scenario: _Levelled, name: str) -> bool:
    """Whether the scenario's level has the effect of this name."""
    return column_of(scenario) in _BY_NAME[name].levels


def levels_with(name: str) -> str:
    """Levels that have the effect of this name, for messages."""
    levels = dict.fromkeys(column.partition(",")[0] for column in _BY_NAME[name].levels)
    *others, last = levels
    return f"{', '.join(others)} or {last}" if others else last


def refused(scenario: _Levelled) -> tuple[str, Any, str] | None:
    """Key, value and remedy of the first effect that the scenario asks for and its level does not have; None: none.

    Level `geometric` reports the truth, whatever the instrument.
    """
    column = column_of(scenario)
    if column == GEOMETRIC:
        return None
    for effect in EFFECTS:
        if not effect.key or column in effect.levels:
            continue
        value = reduce(getattr, effect.key.split("."), cast(Any, scenario))
        if value not in effect.without:
            return effect.key, value, f"{effect.remedy} at level {scenario.level}"
    return None


def markdown() -> str:
    """The table of effects by level, as it stands in `docs/evidence/accuracy.md`."""
    head = ["effect", *(f"`{column}`" for column in COLUMNS)]
    rows = [
        [effect.name, *("yes" if column in effect.levels else "-" for column in COLUMNS)]
        for effect in EFFECTS
    ]
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)

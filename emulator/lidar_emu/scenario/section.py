"""Base of every part of a scenario: strict values, no unknown keys, each key documented."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Annotated, NamedTuple, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError


class Limit(NamedTuple):
    """Largest magnitude of a quantity."""

    largest: float
    unit: str


LIMITS = {
    "m": Limit(1e9, "m"),  # larger than the Sun; float64 resolves 0.1 um there
    "s": Limit(1e9, "s"),  # 30 years, within the nanoseconds of an int64
    "hz": Limit(1e15, "Hz"),  # above the laser's carrier
    "hz2": Limit(1e30, "Hz2"),
    "mps": Limit(3e8, "m/s"),  # the speed of light
    "mps2": Limit(1e6, "m/s2"),
    "deg": Limit(1e6, "deg"),  # float64 resolves 1e-10 deg there
    "rad": Limit(1e3, "rad"),
    "w": Limit(1e9, "W"),
    "db": Limit(1e3, "dB"),  # its square as a ratio is a float64
    "k": Limit(1e6, "K"),
    "degps": Limit(1e6, "deg/s"),
    "kg": Limit(1e9, "kg"),
    "kgm2": Limit(1e15, "kg m2"),
    "n": Limit(1e12, "N"),
    "nm": Limit(1e12, "N m"),
    "npm": Limit(1e12, "N/m"),
    "c": Limit(1e6, "deg C"),
}
"""Limits of all keys of a scenario by the unit that ends their name; a key may have a narrower one."""


class Part(BaseModel):
    """A mapping in a scenario file. The docstring below each key is its documentation."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        frozen=True,
        allow_inf_nan=False,
        validate_default=True,
        defer_build=True,
    )

    @model_validator(mode="after")
    def _validate_values(self) -> Self:
        for key, limit in limits_of(type(self)).items():
            for stated, value in _stated(key, getattr(self, key)):
                numbers = value if isinstance(value, tuple | list) else (value,)
                if any(isinstance(n, int | float) and abs(n) > limit.largest for n in numbers):
                    raise unusable(stated, value, f"at most {limit.largest:g} {limit.unit} in magnitude")
        self._check()
        return self

    def _check(self) -> None:
        """Refuse values that do not go together; each of them is valid on its own.

        Raises:
            PydanticCustomError: as `unusable` makes it.
        """


@cache
def limits_of(part: type[Part]) -> dict[str, Limit]:
    """Limits of the keys whose name ends in a unit; a key of a ratio, such as `_per_m`, has its own."""
    units = {key: key.rpartition("_")[2] for key in part.model_fields if "_per_" not in key}
    return {key: LIMITS[unit] for key, unit in units.items() if unit in LIMITS}


def _stated(key: str, value: object) -> Iterator[tuple[str, object]]:
    """A key with its value, or the dotted keys of a ramp's values in the same unit."""
    if not isinstance(value, Part):
        yield key, value
        return
    for below, item in value:
        if "_" not in below:
            yield f"{key}.{below}", item


def unusable(key: str, value: object, expected: str) -> PydanticCustomError:
    """The error that a check of several keys raises.

    Args:
        key: dotted key below the part.
        value: what was found there; a `Finding` describes it in words.
        expected: what the key must be, such as "at most 3"; beside a `Finding`, what can be done.
    """
    context = {"key": key, "value": value, "expected": expected}
    return PydanticCustomError("unusable", "{key}: must be {expected} (got {value})", context)


_SWITCH_WORDS = {"on": True, "yes": True, "off": False, "no": False}


def _switch(value: object) -> object:
    """`on`, `off`, `yes`, `no` as an author means them: YAML 1.2 reads them as text."""
    return _SWITCH_WORDS.get(value.lower(), value) if isinstance(value, str) else value


Switch = Annotated[bool, BeforeValidator(_switch)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Albedo = Annotated[float, Field(ge=0, le=1)]
Fraction = Annotated[float, Field(gt=0, le=1)]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=360)]
Vector3 = tuple[float, float, float]

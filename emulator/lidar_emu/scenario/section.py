"""Base of every part of a scenario: strict values, no unknown keys, each key documented."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

LONGEST_M = 1e9
"""Largest length, coordinate or height in a scenario: larger than the Sun; float64 resolves 0.1 um there."""


class Part(BaseModel):
    """A mapping in a scenario file. The docstring below each key is its documentation."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        validate_default=True,
    )

    @model_validator(mode="after")
    def _lengths_have_a_limit(self) -> Self:
        for key in _length_keys(type(self)):
            value = getattr(self, key)
            for length_m in value if isinstance(value, tuple) else (value,):
                if isinstance(length_m, float) and abs(length_m) > LONGEST_M:
                    raise unusable(key, value, f"lengths up to {LONGEST_M:g} m")
        return self


@cache
def _length_keys(part: type[Part]) -> tuple[str, ...]:
    """Keys of a part in metres."""
    return tuple(key for key in part.model_fields if key.endswith("_m"))


def unusable(key: str, value: object, allowed: str) -> PydanticCustomError:
    """The error that a part's own check raises: dotted key below the part, value, and what is allowed."""
    context = {"key": key, "value": value, "allowed": allowed}
    return PydanticCustomError("unusable", "{key}: {value} is not usable; allowed: {allowed}", context)


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

"""The default interface with texts that would end the strings or elements of a generated document."""

from __future__ import annotations

import json
from importlib.resources import files

from lidar_protocol import load
from lidar_protocol.definitions import Interface

_TEXTS = 'name = "lidar-emu"', 'meaning = "The laser emits"', 'unit = "dB"'


def with_texts(hostile: str) -> Interface:
    """The default interface with a text as its name, as a meaning and as a unit."""
    definition = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
    for line in _TEXTS:
        assert line in definition
        definition = definition.replace(line, f"{line.split()[0]} = {json.dumps(hostile)}")
    return load(definition, "hostile.toml")

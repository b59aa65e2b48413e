"""Grounds for the tests, and a cache folder of their own."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from lidar_emu.scenario.ground import Generated

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def ground():
    """A small ground with what is asked of it, relief, craters or rocks."""

    def made(**keys):
        return Generated.model_validate({"kind": "generated", "size_m": 256.0, "spacing_m": 1.0, **keys})

    return made


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Where these tests keep their grounds."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    return folder / "lidar-emu" / "ground"

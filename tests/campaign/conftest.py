"""For the tests of campaigns."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from small_campaign import ROWS, SMALL, Here

from lidar_emu.campaign.description import prepare
from lidar_emu.campaign.run import fly_campaign


@pytest.fixture
def campaign_file(tmp_path):
    def write(text: str = SMALL, runs: int = 12) -> Path:
        path = tmp_path / "campaign.yaml"
        path.write_text(text.format(runs=runs))
        return path

    return write


@pytest.fixture
def fly(campaign_file, tmp_path):
    """Fly a small campaign into a folder; its pool, and `flown.counts` of all runs."""

    def flown(name="out", pool=None, text=SMALL, runs=12, reported=lambda _: None):
        pool = pool or Here()
        with closing(pool):
            prepared = prepare(campaign_file(text, runs), [], None)
            _, flown.counts = fly_campaign(prepared, ROWS, tmp_path / name, pool, reported)
        return pool

    return flown

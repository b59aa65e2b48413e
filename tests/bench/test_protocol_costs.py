"""What `lidar-emu bench protocol` compares is equal, and it prints its measurements."""

from __future__ import annotations

import json
from importlib import import_module

import pytest
from click.testing import CliRunner

from lidar_emu.bench.protocol import Job, protocol_jobs
from lidar_emu.cli import cli


@pytest.mark.parametrize("job", protocol_jobs(), ids=lambda job: job.name)
def test_the_exact_path_comes_to_the_same(job: Job) -> None:
    assert job.fast() == job.exact() == job.fast()
    assert job.fast()


def test_every_cost_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(import_module("lidar_emu.cli.bench.protocol"), "_ROUNDS", 1)
    reported = CliRunner().invoke(cli, ["bench", "protocol", "--json"], standalone_mode=False)
    costs = json.loads(reported.stdout)
    assert [cost["name"] for cost in costs] == [job.name for job in protocol_jobs()]
    assert all(cost["time_s"] > 0.0 < cost["exact_s"] for cost in costs)
    lines = CliRunner().invoke(cli, ["bench", "protocol"], standalone_mode=False).stdout.splitlines()
    assert len(lines) == len(costs) + 1

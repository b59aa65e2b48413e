"""A campaign on a Dask cluster, one of whose workers is killed."""

from __future__ import annotations

import os
import signal

import pytest
from small_campaign import content

from lidar_emu.campaign.run import ClusterPool
from lidar_emu.errors import InputError

distributed = pytest.importorskip("distributed", reason="Dask is not installed")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore:Couldn't detect a suitable IP")
def test_a_killed_worker_leaves_no_trace(fly, tmp_path):
    fly("here", runs=40)
    killed = []
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]

        def reported(progress):
            if progress.done >= 8 and not killed:
                os.kill(pids[1], signal.SIGKILL)
                killed.append(pids[1])

        fly("cluster", ClusterPool(cluster.scheduler_address), runs=40, reported=reported)
    assert killed
    assert content(tmp_path / "cluster") == content(tmp_path / "here")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "", "foo://here:1"])
def test_no_scheduler_is_reported(address, monkeypatch):
    monkeypatch.setattr("lidar_emu.campaign.run._CONNECT", "1s")
    with pytest.raises(InputError, match=r"--scheduler: .*no scheduler"):
        ClusterPool(address)

"""A campaign on a Dask cluster, one of whose workers is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial

import pytest
from small_campaign import content

from lidar_emu.campaign.run import ClusterPool
from lidar_emu.errors import InputError, RunError

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


def dask(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments, "--no-dashboard"], stderr=subprocess.DEVNULL
    )


@pytest.mark.slow
def test_a_dead_scheduler_ends_the_campaign_which_another_one_continues(fly, tmp_path, monkeypatch):
    monkeypatch.setattr("lidar_emu.campaign.run._CONNECT", "2s")
    fly("here", runs=40)

    def on_cluster(reported):
        file = tmp_path / "scheduler.json"
        file.unlink(missing_ok=True)
        with (
            dask(
                "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file)
            ) as scheduler,
            dask("worker", "--nthreads", "1", "--no-nanny", "--scheduler-file", str(file)) as worker,
        ):
            try:
                with distributed.Client(scheduler_file=str(file), timeout="15m") as client:
                    client.wait_for_workers(1)
                    address = client.scheduler.address
                fly("cluster", ClusterPool(address), runs=40, reported=partial(reported, scheduler))
            finally:
                worker.kill()
                scheduler.kill()

    def kill(scheduler, progress):
        if progress.done >= 8:
            scheduler.kill()
            scheduler.wait()

    with pytest.raises(RunError, match="the scheduler is gone; repeat the command to fly the remaining runs"):
        on_cluster(kill)
    on_cluster(lambda *_: None)
    assert content(tmp_path / "cluster") == content(tmp_path / "here")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "", "foo://here:1"])
def test_no_scheduler_is_reported(address, monkeypatch):
    monkeypatch.setattr("lidar_emu.campaign.run._CONNECT", "1s")
    with pytest.raises(InputError, match=r"--scheduler: .*no scheduler"):
        ClusterPool(address)

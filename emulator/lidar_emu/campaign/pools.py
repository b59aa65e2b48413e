"""Pools of workers for batches: processes on this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, Protocol

from lidar_emu.errors import Finding, InputError

_ONE_THREAD = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
_CONNECT = "10s"


class Pool(Protocol):
    """An executor that may lose workers."""

    slots: int
    """Number of batches processed at once."""
    worker_errors: tuple[type[BaseException], ...]
    """Exceptions that a future raises when its worker died."""

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        """As `concurrent.futures.Executor`."""
        ...

    def replace_workers(self) -> None:
        """Replace workers that died."""
        ...

    def stop(self) -> None:
        """Release the workers, whatever they are doing."""
        ...


class LocalPool:
    """Processes on this machine, one thread each; they exit when this process ends, even if it is killed."""

    worker_errors: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)

    def __init__(self, slots: int) -> None:
        self.slots = slots
        self._start()

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        """As `concurrent.futures.Executor`."""
        with one_thread_each(), _ctrl_c_blocked():
            return self._executor.submit(work, *args)

    def replace_workers(self) -> None:
        """Start a new executor, since an executor whose process died accepts no more work."""
        self.stop()
        self._start()

    def stop(self) -> None:
        """End the processes at once; unfinished files do not appear."""
        self._control_pipe.close()
        self._executor.shutdown(wait=True, cancel_futures=True)

    def _start(self) -> None:
        # Spawned, since a fork of a process with threads may hang.
        context = multiprocessing.get_context("spawn")
        theirs, self._control_pipe = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(
            self.slots, mp_context=context, initializer=_begin_worker, initargs=(theirs,)
        )


class ClusterPool:
    """The workers of a Dask scheduler, which reassigns the work of a dead worker.

    Raises:
        InputError: there is no scheduler, it has no workers, or Dask is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client, KilledWorker
            from distributed.comm import resolve_address
        except ImportError:
            remedy = "pip install 'lidar-emu[cluster]'"
            raise InputError("--scheduler", None, Finding("Dask is not installed"), remedy) from None
        try:
            # A client with an invalid address is left half built, and prints and waits when it is destroyed.
            resolve_address(address)
            self._client = Client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            found = Finding(f"{address}: no scheduler ({type(error).__name__})")
            raise InputError(
                "--scheduler", None, found, "must be an address such as tcp://host:8786"
            ) from None
        self.slots = sum(self._client.nthreads().values())
        if self.slots == 0:
            raise InputError(
                "--scheduler", None, Finding(f"{address} has no workers"), "must be a scheduler with workers"
            )
        self.worker_errors: tuple[type[BaseException], ...] = (KilledWorker, CancelledError)
        # Not pure: a batch writes files, so a repeated batch must run again.
        self._executor: Executor = self._client.get_executor(pure=False)

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        """As `concurrent.futures.Executor`."""
        return self._executor.submit(work, *args)

    def replace_workers(self) -> None:
        """Nothing to do: the scheduler replaces workers."""

    def stop(self) -> None:
        """Disconnect from the scheduler, which cancels unfinished batches."""
        self._client.close()


def _begin_worker(control_pipe: Connection) -> None:
    """Leave Ctrl-C to the parent, and exit once its end of the control pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def exit_with_parent() -> None:
        control_pipe.poll(None)
        os._exit(0)

    threading.Thread(target=exit_with_parent, daemon=True).start()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Limit processes started meanwhile to one thread each, since there is a process per core."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def usable_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Block SIGINT in processes started meanwhile, where a system can; this process receives it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

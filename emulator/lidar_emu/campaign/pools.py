"""Who flies the batches: processes of this machine, or the workers of a Dask scheduler."""

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
    """Batches that it flies at once."""
    deaths: tuple[type[BaseException], ...]
    """What a future raises whose worker died."""

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        """As `concurrent.futures.Executor`."""
        ...

    def mend(self) -> None:
        """After a death: have all workers again."""
        ...

    def stop(self) -> None:
        """Let go of the workers, whatever they are doing."""
        ...


class LocalPool:
    """Processes of this machine, one thread each; they end when this process does, however it does."""

    deaths: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)

    def __init__(self, slots: int) -> None:
        self.slots = slots
        self._start()

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        """As `concurrent.futures.Executor`."""
        with one_thread_each(), _deaf_to_ctrl_c():
            return self._executor.submit(work, *args)

    def mend(self) -> None:
        """The pool of a process that died takes no more work: another one does."""
        self.stop()
        self._start()

    def stop(self) -> None:
        """End the processes at once; what they were writing was not there yet."""
        self._lifeline.close()
        self._executor.shutdown(wait=True, cancel_futures=True)

    def _start(self) -> None:
        # Spawned, since a fork of a process with threads may hang.
        context = multiprocessing.get_context("spawn")
        theirs, self._lifeline = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(
            self.slots, mp_context=context, initializer=_begin_worker, initargs=(theirs,)
        )


class ClusterPool:
    """The workers of a Dask scheduler, which itself gives the work of a dead one to another.

    Raises:
        InputError: there is no scheduler, or it has no workers; or Dask is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client, KilledWorker
            from distributed.comm import resolve_address
        except ImportError:
            allowed = "allowed after: pip install 'lidar-emu[cluster]'"
            raise InputError("--scheduler", None, Finding("Dask is not installed"), allowed) from None
        try:
            # A client of no address at all would be half made, and its end waits and prints.
            resolve_address(address)
            self._client = Client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            found = Finding(f"{address}: no scheduler ({type(error).__name__})")
            raise InputError(
                "--scheduler", None, found, "allowed: an address such as tcp://host:8786"
            ) from None
        self.slots = sum(self._client.nthreads().values())
        if self.slots == 0:
            raise InputError(
                "--scheduler", None, Finding(f"{address} has no workers"), "allowed: one that has"
            )
        self.deaths: tuple[type[BaseException], ...] = (KilledWorker, CancelledError)
        # Not pure: a batch writes files, and one that is asked for again is meant to be flown again.
        self._executor: Executor = self._client.get_executor(pure=False)

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        """As `concurrent.futures.Executor`."""
        return self._executor.submit(work, *args)

    def mend(self) -> None:
        """The scheduler's business."""

    def stop(self) -> None:
        """Let go of the scheduler, which then cancels what is not done."""
        self._client.close()


def _begin_worker(lifeline: Connection) -> None:
    """Ctrl-C is the parent's to answer; when its end of the lifeline is closed there is nobody to work for."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow() -> None:
        lifeline.poll(None)
        os._exit(0)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes that start now compute with one thread: there is one of them for every core."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Processes that start now do not hear Ctrl-C from their first instant on; ours hears it a little later."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

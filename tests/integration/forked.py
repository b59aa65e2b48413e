"""`lidar-emu` in a process that is forked from one in which all modules are loaded and all kernels compiled.

Loading them takes seconds of a processor; the tests start over a hundred programs. What follows is the command as it is
typed: its own session, folder, environment and standard descriptors, and `lidar_emu.__main__.main` on its arguments.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from multiprocessing.context import ForkServerContext
from pathlib import Path
from subprocess import TimeoutExpired

from waiting import eventually

_PRELOADED = "preloaded"
"""Module of this folder that loads what the programs need."""


def _server() -> ForkServerContext:
    """The context whose server has loaded everything; it ends with this process."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([_PRELOADED])
    return context


class ForkedProcess:
    """Has of `subprocess.Popen` what the tests use."""

    def __init__(self, arguments: list[str], folder: Path, out: Path, err: Path) -> None:
        path = os.environ.get("PYTHONPATH")
        # The server, started with the first process, has to find its module.
        os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), path or ""])
        try:
            environment = {**os.environ, "PYTHONPATH": path or ""}
            self._process = _server().Process(target=_run, args=(arguments, folder, out, err, environment))
            self._process.start()
        finally:
            if path is None:
                del os.environ["PYTHONPATH"]
            else:
                os.environ["PYTHONPATH"] = path
        assert self._process.pid is not None
        self.pid = self._process.pid
        eventually(lambda: self.poll() is not None or os.getpgid(self.pid) == self.pid)
        self.terminate, self.kill = self._process.terminate, self._process.kill

    def poll(self) -> int | None:
        """Exit code once it has ended; minus the signal where one ended it."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; returns the exit code."""
        self._process.join(timeout)
        code = self._process.exitcode
        if code is None:
            assert timeout is not None
            raise TimeoutExpired("lidar-emu", timeout)
        return code


def _run(arguments: list[str], folder: Path, out: Path, err: Path, environment: dict[str, str]) -> None:
    os.setsid()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for number, (path, flags) in enumerate(
        [(Path(os.devnull), os.O_RDONLY), (out, os.O_WRONLY), (err, os.O_WRONLY)]
    ):
        descriptor = os.open(path, flags)
        os.dup2(descriptor, number)
        os.close(descriptor)
    sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
    sys.argv = ["lidar-emu", *arguments]
    from lidar_emu.__main__ import main

    main()

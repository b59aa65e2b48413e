"""The Rerun viewer as a process: in a window, or in a browser on this machine."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lidar_emu.errors import RunError
from lidar_emu.viewer.addresses import LOCAL, check_free, free_port

_END_LIMIT_S = 2.0


class RerunViewer:
    """A viewer that listens on this machine alone.

    Args:
        process: the program.
        port: where it takes data.
    """

    def __init__(self, process: subprocess.Popen[bytes], port: int) -> None:
        self._process = process
        self.url = f"rerun+http://{LOCAL}:{port}/proxy"
        """Where to send the data."""

    def is_open(self) -> bool:
        """Whether the viewer has neither been closed nor died."""
        return self._process.poll() is None

    def wait(self) -> None:
        """Wait until the viewer is closed.

        Raises:
            RunError: it failed.
        """
        status = self._process.wait()
        if status > 0:
            raise RunError(f"the viewer has ended with exit code {status}")


@contextmanager
def rerun_viewer(web_port: int | None) -> Iterator[RerunViewer]:
    """Start the viewer, without its usage statistics, and end it with the context.

    Args:
        web_port: port of the page for a browser; None: a window.

    Raises:
        InputError: the port, or the next one, is in use.
    """
    import rerun_cli

    if web_port is None:
        port, web = free_port(), []  # another viewer at the usual port would take the data
    else:
        check_free("--port", web_port, web_port + 1)
        port, web = web_port + 1, ["--serve-web", "--web-viewer-port", str(web_port)]
    environment = {**os.environ, "RUST_LOG": "error", "RERUN_ANALYTICS": "0"}
    # The program itself: SIGTERM would end the package's Python wrapper and leave the viewer running.
    program = str(Path(rerun_cli.__file__).parent / "rerun")
    command = [program, "--bind", LOCAL, "--port", str(port), "--expect-data-soon", *web]
    with subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL) as process:
        try:
            yield RerunViewer(process, port)
        finally:
            process.terminate()
            try:
                process.wait(_END_LIMIT_S)
            except subprocess.TimeoutExpired:  # it is stopped, or hangs
                process.kill()

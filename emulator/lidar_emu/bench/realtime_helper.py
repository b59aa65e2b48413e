"""A process beside the flight that measures, and what its parent knows of it.

It is told JSON lines on its standard input, which is also its lifeline, answers with JSON lines, and at its end
writes a line with the number of its arrays and then the arrays, one after the other, all of the same length.
"""

from __future__ import annotations

import json
import subprocess
import sys
from types import TracebackType
from typing import Any, Self

import numpy as np

from lidar_emu.errors import RunError
from lidar_emu.numerics.arrays import IntArray


class Helper:
    """The parent's side. Leaving its context ends the process.

    Args:
        module: run as a program, in a session of its own, where no terminal's Ctrl-C reaches it.
    """

    def __init__(self, module: str) -> None:
        self._module = module
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._lifeline = self._process.stdin
        self._answers = self._process.stdout

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()
        self._answers.close()
        self._hang_up()

    def tell(self, **order: object) -> None:
        """Give it a line."""
        self._lifeline.write(json.dumps(order).encode() + b"\n")
        self._lifeline.flush()

    def hear(self) -> dict[str, Any]:
        """Its next line.

        Raises:
            RunError: it ended without one.
        """
        line = self._answers.readline()
        if not line:
            raise RunError(f"{self._module} ended (exit code {self._process.wait()})")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def finish(self) -> list[IntArray]:
        """Cut the lifeline and take what it measured."""
        self._hang_up()
        count = self.hear()["arrays"]
        values = np.frombuffer(self._answers.read(), dtype=np.int64)
        return list(values.reshape(count, -1))

    def _hang_up(self) -> None:
        try:
            self._lifeline.close()
        except BrokenPipeError:  # it was gone before it heard the last line
            return

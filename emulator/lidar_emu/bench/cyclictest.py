"""cyclictest of rt-tests beside the flight, if installed: the lateness of the kernel alone."""

from __future__ import annotations

import shutil
import signal
import subprocess
from types import TracebackType
from typing import Self

_PRIORITY = 10
_LONGEST_US = 20_000


class Cyclictest:
    """Runs from entry to exit, if it is installed.

    Args:
        period_ns: from wake-up to wake-up.
        count: wake-ups.
    """

    def __init__(self, period_ns: int, count: int) -> None:
        self._command = cyclictest_command(period_ns, count)
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        if shutil.which(self._command[0]) is not None:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                start_new_session=True,
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            assert self._process.stdout is not None
            self._process.stdout.close()

    def result(self) -> dict[str, int] | None:
        """p50, p99, p99.9 and maximum of its wake-up lateness; None where it is not installed or had no permission."""
        if self._process is None:
            return None
        self._process.send_signal(signal.SIGINT)  # it then prints its histogram
        return histogram_figures(self._process.communicate()[0])


def cyclictest_command(period_ns: int, count: int) -> list[str]:
    """The command line: priority of the port process, idle states unchanged, a histogram in microseconds."""
    options = {"--priority": _PRIORITY, "--interval": max(1, period_ns // 1000), "--loops": count}
    given = [f"{option}={value}" for option, value in options.items()]
    return [
        "cyclictest",
        "--quiet",
        "--mlockall",
        "--laptop",
        "--threads=1",
        *given,
        f"--histogram={_LONGEST_US}",
    ]


def histogram_figures(text: str) -> dict[str, int] | None:
    """Read its histogram: lines of microseconds and count, comments beginning with #.

    A wake-up beyond the histogram shows in the maximum alone, of which there is a comment.
    """
    rows = [line.split() for line in text.splitlines() if line[:1].isdigit()]
    counts = [(int(row[0]), int(row[1])) for row in rows if len(row) >= 2]
    total = sum(count for _, count in counts)
    if not total:
        return None
    figures = {"count": total}
    for name, fraction in (("p50_ns", 0.5), ("p99_ns", 0.99), ("p99_9_ns", 0.999), ("max_ns", 1.0)):
        seen = 0
        for microseconds, count in counts:
            seen += count
            if seen >= fraction * total:
                figures[name] = microseconds * 1000
                break
    longest = [
        line.split(":")[1].split() for line in text.splitlines() if line.startswith("# Max Latencies:")
    ]
    if longest and longest[0]:
        figures["max_ns"] = max(figures["max_ns"], int(longest[0][0]) * 1000)
    return figures

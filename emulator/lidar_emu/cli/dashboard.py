"""Live display on the terminal: content in, drawing out.

A separate process draws it, so that a run never waits for the terminal: `python -m lidar_emu.cli.dashboard DESCRIPTOR`
draws what a socket receives.
"""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from typing import Any, Self

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from lidar_emu.cli.plain_console import PlainConsole
from lidar_emu.cli.terminal import print_line
from lidar_emu.report.beam_colours import beam_colour
from lidar_emu.runtime.clock import Clock

_EVERY_NS = 200_000_000
_END_LIMIT_S = 2.0
_LONGEST = 1 << 18
_NARROW, _ROOMY = 52, 70
"""Terminal widths in columns: below the first, SNR is not shown; from the second on, columns are padded."""
_WIDE = 120
"""Terminal width from which on curves are shown."""
_LABEL_WIDTH = 9
_BARS = " ▁▂▃▄▅▆▇█"
_PARTS = " ▏▎▍▌▋▊▉█"
_BESIDE_BAR, _LONGEST_BAR = 62, 60
"""Columns of the other values of a beam, and of the longest bar."""
_SECONDS = 60


class Dashboard:
    """Client of the display process: drops updates that cannot be sent at once; prints lines directly if it has died.

    The process ignores Ctrl-C: it ends, and restores the terminal, when this end of the socket is closed.
    """

    def __init__(self) -> None:
        self._clock = Clock()
        self._next_ns = 0
        self._pending: list[str] = []
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "lidar_emu.cli.dashboard", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        ours.setblocking(False)
        self._socket: socket.socket | None = ours

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        try:
            self._process.wait(_END_LIMIT_S)
        except subprocess.TimeoutExpired:  # the process hangs in a blocked terminal
            self._process.kill()
            self._process.wait()
        self._print_pending()

    @property
    def is_due(self) -> bool:
        """Whether it is time for an update."""
        return self._socket is not None and self._clock.now_ns() >= self._next_ns

    def show(self, content: dict[str, Any]) -> None:
        """Update the display; the content is described at `render`."""
        self._next_ns = self._clock.now_ns() + _EVERY_NS
        self._flush()
        self._send(content)

    def print_line(self, text: str) -> None:
        """Print a line that stays, above the display."""
        self._pending.append(text)
        self._flush()
        if self._socket is None:
            self._print_pending()

    def _flush(self) -> None:
        while self._pending and self._send({"line": self._pending[0]}):
            self._pending.pop(0)

    def _send(self, message: dict[str, Any]) -> bool:
        if self._socket is None:
            return False
        try:
            self._socket.send(json.dumps(message).encode())
        except BlockingIOError:
            return False
        except OSError:
            self._socket.close()
            self._socket = None
            self._print_pending()
            return False
        return True

    def _print_pending(self) -> None:
        pending, self._pending = self._pending, []
        for text in pending:
            print_line(text)


def main(descriptor: int) -> None:
    """Draw until the other end of the socket is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    console = PlainConsole()
    with (
        socket.socket(fileno=descriptor) as receiver,
        Live(console=console, auto_refresh=False, transient=True, vertical_overflow="crop") as live,
    ):
        while message := receiver.recv(_LONGEST):
            content = json.loads(message)
            if "line" in content:
                console.print_lines(content["line"])
            else:
                live.update(render(content, console.width, console.height), refresh=True)


def render(content: dict[str, Any], width: int, height: int) -> RenderableType:
    """The display for a terminal of this size.

    Args:
        content: `beams`: name, range in m, closing speed in m/s, SNR in dB, reason if invalid or None;
            `scale_m`: range of a bar of full length; `lines`: label and text; `curves`: label, values from 0 to 1 of
            the last 60 seconds, and text, shown on a wide terminal.
        width: in columns.
        height: in rows.
    """
    lines: Sequence[tuple[str, str]] = content["lines"]
    if width >= _WIDE:
        curves = content.get("curves", ())
        lines = [*lines, *((label, f"{_bars(values)}  {text}") for label, values, text in curves)]
    room = max(1, height - len(lines) - 4)
    beams, rest = content["beams"][:room], content["beams"][room:]
    table = Table(box=None, pad_edge=False, padding=(0, 2 if width >= _ROOMY else 1, 0, 0))
    has_bars, has_snr = width >= _ROOMY and bool(content.get("scale_m")), width >= _NARROW
    bar_width = min(width - _BESIDE_BAR, _LONGEST_BAR)
    table.add_column("beam", justify="right", no_wrap=True)
    table.add_column("range m", justify="right", no_wrap=True)
    if has_bars:
        table.add_column("", width=bar_width, no_wrap=True)
    for heading in ("speed m/s", "SNR dB") if has_snr else ("speed m/s",):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("state", no_wrap=True, overflow="ellipsis")
    for name, range_m, speed_mps, snr_db, why in beams:
        colour = beam_colour(int(name.rpartition(".")[2]))
        cells: list[Text | str] = [Text(name, style=f"bold {colour}"), _number(range_m, ".3f")]
        if has_bars:
            cells.append(Text(_bar((range_m or 0.0) / content["scale_m"], bar_width), style=colour))
        cells.append(_number(speed_mps, "+.4f"))
        if has_snr:
            cells.append(_number(snr_db, ".1f"))
        table.add_row(*cells, Text(why or "valid", style="yellow" if why else "green"))
    more = [Text(f"and {len(rest)} beams more", style="dim")] if rest else []
    below = [
        _one_row(
            Text.assemble((f"{label:<{_LABEL_WIDTH}} ", "dim"), (text, "red" if label == "faults" else ""))
        )
        for label, text in lines
    ]
    return Group(table, *more, Text(), *below)


def _bars(values: Sequence[float]) -> str:
    steps = len(_BARS) - 1
    return "".join(_BARS[round(steps * min(max(value, 0.0), 1.0))] for value in values).rjust(_SECONDS)


def _bar(share: float, width: int) -> str:
    """A bar from the left, in eighths of a column."""
    eighths = round(8 * width * min(max(share, 0.0), 1.0))
    return _PARTS[8] * (eighths // 8) + (_PARTS[eighths % 8] if eighths % 8 else "")


def _number(value: float | None, how: str) -> str:
    return "-" if value is None else format(value, how)


def _one_row(text: Text) -> Text:
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


if __name__ == "__main__":
    main(int(sys.argv[1]))

"""The display process: `python -m lidar_emu.cli.dashboard_process DESCRIPTOR` draws what a socket receives."""

from __future__ import annotations

import json
import signal
import socket
import sys
from collections.abc import Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from lidar_emu.cli.plain_console import PlainConsole

_LONGEST = 1 << 18
_NARROW, _ROOMY = 52, 70
"""Terminal widths in columns: below the first, SNR is not shown; from the second on, columns are padded."""
_WIDE = 120
"""Terminal width from which on curves are shown."""
_LABEL_WIDTH = 9
_BARS, _SECONDS = " ▁▂▃▄▅▆▇█", 60


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
                console.print(content["line"], highlight=False, soft_wrap=True)
            else:
                live.update(render(content, console.width, console.height), refresh=True)


def render(content: dict[str, Any], width: int, height: int) -> RenderableType:
    """The display for a terminal of this size.

    Args:
        content: `title`; `beams`: name, range in m, closing speed in m/s, SNR in dB, reason if invalid or None;
            `lines`: label and text; `curves`: label, values from 0 to 1 of the last 60 seconds, and text, shown on a
            wide terminal.
        width: in columns.
        height: in rows.
    """
    lines: Sequence[tuple[str, str]] = content["lines"]
    if width >= _WIDE:
        curves = content.get("curves", ())
        lines = [*lines, *((label, f"{_bars(values)}  {text}") for label, values, text in curves)]
    room = max(1, height - len(lines) - 5)
    beams, rest = content["beams"][:room], content["beams"][room:]
    table = Table(box=None, pad_edge=False, padding=(0, 2 if width >= _ROOMY else 1, 0, 0))
    for heading in ("beam", "range m", "speed m/s", *(("SNR dB",) if width >= _NARROW else ())):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("state", no_wrap=True, overflow="ellipsis")
    for name, range_m, speed_mps, snr_db, why in beams:
        numbers = [_number(range_m, ".3f"), _number(speed_mps, "+.4f")]
        if width >= _NARROW:
            numbers.append(_number(snr_db, ".1f"))
        table.add_row(Text(name), *numbers, Text(why or "valid", style="yellow" if why else "green"))
    more = [Text(f"and {len(rest)} beams more", style="dim")] if rest else []
    below = [_line(label, text) for label, text in lines]
    return Group(_one_row(Text(content["title"], style="bold")), table, *more, Text(), *below)


def _bars(values: Sequence[float]) -> str:
    """Draw a column per second, the latest at the right."""
    steps = len(_BARS) - 1
    return "".join(_BARS[round(steps * min(max(value, 0.0), 1.0))] for value in values).rjust(_SECONDS)


def _number(value: float | None, how: str) -> str:
    return "-" if value is None else format(value, how)


def _line(label: str, text: str) -> Text:
    style = "red" if label == "faults" else ""
    return _one_row(Text.assemble((f"{label:<{_LABEL_WIDTH}} ", "dim"), (text, style)))


def _one_row(text: Text) -> Text:
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


if __name__ == "__main__":
    main(int(sys.argv[1]))

"""Signals that end a run."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread


@contextmanager
def on_signals(act: Callable[..., None]) -> Iterator[None]:
    """Handle SIGINT, SIGTERM and SIGHUP by `act` in a context.

    A signal that is ignored stays ignored: Ctrl-C is not meant for a shell's background job. Outside the main thread
    nothing changes.
    """
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if current_thread() is main_thread() else ()
    previous = {number: signal.getsignal(number) for number in numbers}
    handled = [number for number in numbers if previous[number] is not signal.SIG_IGN]
    for number in handled:
        signal.signal(number, act)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, previous[number])

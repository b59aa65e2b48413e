"""Signals that end a run."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import current_thread, main_thread

_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextmanager
def on_signals(act: Callable[..., None]) -> Iterator[None]:
    """Handle SIGINT, SIGTERM and SIGHUP by `act` in a context.

    A signal that is ignored stays ignored: Ctrl-C is not meant for a shell's background job. Outside the main thread
    nothing changes.
    """
    numbers = _ENDING if current_thread() is main_thread() else ()
    previous = {number: signal.getsignal(number) for number in numbers}
    handled = [number for number in numbers if previous[number] is not signal.SIG_IGN]
    for number in handled:
        signal.signal(number, act)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, previous[number])


@contextmanager
def until_signal() -> Iterator[None]:
    """End the context quietly at SIGINT (Ctrl-C), SIGTERM or SIGHUP."""
    with suppress(KeyboardInterrupt), on_signals(signal.default_int_handler):
        yield

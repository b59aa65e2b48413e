"""What a run makes of the signals that are meant to end it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread


@contextmanager
def on_signals(act: Callable[..., None]) -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP do something else for a while.

    A signal that is ignored stays so: a shell's background job is not meant to hear Ctrl-C. Threads other than
    the main one have no say in this.
    """
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if current_thread() is main_thread() else ()
    previous = {number: signal.getsignal(number) for number in numbers}
    heard = [number for number in numbers if previous[number] is not signal.SIG_IGN]
    for number in heard:
        signal.signal(number, act)
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, previous[number])

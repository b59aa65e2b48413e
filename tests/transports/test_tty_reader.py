"""A terminal's input behind a pipe: nothing is lost, and it ends with the terminal, or when it is closed."""

from __future__ import annotations

import os
import threading
from typing import Any

from lidar_emu.transports.byte_channel import TtyReader


def slave_of(raw_pty: Any) -> int:
    return os.open(raw_pty.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def test_more_than_the_pipe_holds_arrives_in_order(raw_pty: Any) -> None:
    sent = bytes(range(256)) * 400
    terminal = slave_of(raw_pty)
    reader = TtyReader(terminal)
    writer = threading.Thread(target=lambda: write_all(raw_pty.master, sent))
    writer.start()
    received = b""
    while len(received) < len(sent):
        received += os.read(reader.descriptor, 1000)
    writer.join()
    assert received == sent
    reader.close()
    os.close(terminal)


def test_a_terminal_that_vanishes_ends_the_pipe(raw_pty: Any) -> None:
    terminal = slave_of(raw_pty)
    reader = TtyReader(terminal)
    os.write(raw_pty.master, b"last words")
    assert os.read(reader.descriptor, 100) == b"last words"
    os.close(raw_pty.master)
    assert os.read(reader.descriptor, 100) == b""
    reader.close()
    os.close(terminal)


def test_a_reader_that_nobody_reads_can_be_closed(raw_pty: Any) -> None:
    before = threading.active_count()
    terminal = slave_of(raw_pty)
    reader = TtyReader(terminal)
    os.set_blocking(raw_pty.master, False)
    try:
        while True:  # until the pipe and the terminal are full
            write_all(raw_pty.master, bytes(1000))
    except BlockingIOError:
        reader.close()
    assert threading.active_count() == before
    os.close(terminal)


def write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]

"""A pty that behaves as a UART, against the arithmetic of a line, on a real pseudo terminal with a simulated clock."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from hypothesis import given
from hypothesis import strategies as st
from waiting import eventually

from lidar_emu.transports.pseudo_terminal import READER_BUFFER_BYTES, UART_BUFFER_BYTES, PtyUart

BYTE_NS = 10e9 / 115_200
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("send"), st.integers(1, 2000)),
        st.tuples(st.just("wait"), st.integers(0, 400_000_000)),
        st.tuples(st.just("read"), st.integers(1, 5000)),
    ),
    max_size=40,
)


class Line:
    """The channel with its reader, and the time."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.channel = PtyUart(None, BYTE_NS, lambda: self.now_ns)
        self.host = os.open(self.channel.description, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.taken, self.read = bytearray(), bytearray()
        assert self.channel.connected()

    def send(self, size: int) -> bool:
        payload = bytes((len(self.taken) + k) % 251 for k in range(size))
        taken = self.channel.send(payload)
        self.taken += payload if taken else b""
        self.settle()
        return taken

    def wait(self, duration_ns: int) -> None:
        self.now_ns += duration_ns
        self.channel.flush()
        self.settle()

    def settle(self) -> None:
        """Wait until the kernel has delivered what was written."""
        eventually(lambda: self.channel.unread() == len(self.taken) - len(self.read), 5)

    def fetch(self, size: int) -> int:
        try:
            data = os.read(self.host, size)
        except BlockingIOError:
            return 0
        self.read += data
        self.settle()
        return len(data)


@contextmanager
def line() -> Iterator[Line]:
    made = Line()
    try:
        yield made
    finally:
        os.close(made.host)
        made.channel.close()


@given(STEPS)
def test_bytes_come_at_the_bit_rate_in_order_and_none_is_lost(steps: list[tuple[str, int]]) -> None:
    with line() as uart:
        for what, size in steps:
            if what == "send":
                held = uart.channel.unread()
                assert uart.send(size) or held + size > UART_BUFFER_BYTES
            elif what == "wait":
                uart.wait(size)
            else:
                uart.fetch(size)
            assert uart.channel.unread() <= READER_BUFFER_BYTES + UART_BUFFER_BYTES
            assert len(uart.read) <= uart.now_ns / BYTE_NS
        for _ in range(8):  # enough for two full buffers
            uart.wait(round(UART_BUFFER_BYTES * BYTE_NS) + 1)
            while uart.fetch(UART_BUFFER_BYTES):
                pass
        assert uart.read == uart.taken
        assert not uart.channel.pending


def test_a_byte_arrives_after_its_time_on_the_line_and_not_before() -> None:
    with line() as uart:
        uart.send(100)
        uart.wait(round(60 * BYTE_NS) + 1)
        assert uart.fetch(4096) == 60
        uart.wait(round(40 * BYTE_NS) - 2)
        assert uart.fetch(4096) == 39
        uart.wait(2)
        assert uart.fetch(4096) == 1


def test_a_reader_that_fetches_nothing_stops_the_line_and_later_packets_are_refused() -> None:
    with line() as uart:
        accepted = [uart.send(1000) and uart.wait(round(1000 * BYTE_NS) + 1) is None for _ in range(12)]
        assert accepted == [True] * 8 + [False] * 4
        uart.fetch(UART_BUFFER_BYTES)
        uart.wait(round(UART_BUFFER_BYTES * BYTE_NS) + 1)
        uart.fetch(UART_BUFFER_BYTES)
        assert uart.read == uart.taken
        assert len(uart.read) == 8000


def test_the_next_reader_starts_with_a_whole_packet() -> None:
    with line() as uart:
        uart.send(100)
        uart.wait(round(50 * BYTE_NS))
        os.close(uart.host)
        assert not uart.channel.connected()
        uart.taken.clear()
        assert not uart.send(10)
        uart.host = os.open(uart.channel.description, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        assert uart.channel.connected()
        assert uart.send(10)
        uart.wait(round(11 * BYTE_NS))
        assert uart.fetch(4096) == 10

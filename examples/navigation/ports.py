"""Shots from a serial line or a CAN bus, and solutions back, as in flight software: pyserial or python-can, and
`lidar_protocol`."""

import sys
from collections.abc import Iterator
from contextlib import suppress

import can
import serial
from solution import NAME, Solution

from lidar_protocol import CanReceiver, Host, Message, SerialReceiver, default_interface

QUIET_S = 5.0
"""A link that is silent for this time after its first packet is taken as ended."""
_SEQUENCE_NUMBERS = 256


def from_serial(path: str, baud: int, unit: int, solutions: list[Solution]) -> Iterator[Message]:
    """Shots until the other side hangs up or falls silent. What is in `solutions` is sent before the next shot.

    Raises:
        OSError: the port cannot be opened.
    """
    receiver, begun = SerialReceiver(default_interface()), False
    host, sent = Host(default_interface(), unit), 0
    try:
        port = serial.Serial(path, baud, timeout=QUIET_S)
    except serial.SerialException as error:
        raise OSError(f"{path}: {error}") from None
    with port, suppress(serial.SerialException):
        while (data := port.read(max(1, port.in_waiting))) or not begun:
            for received in receiver.receive(data):
                if isinstance(received, Message) and received.unit == unit:
                    begun = True
                    yield received
                while solutions:
                    number = sent % _SEQUENCE_NUMBERS
                    port.write(host.encode_message(NAME, sequence=number, **solutions.pop(0)))
                    sent += 1


def from_can(
    interface: str, channel: str, bitrate: int, fd: bool, unit: int, solutions: list[Solution]
) -> Iterator[Message]:
    """Shots until the bus falls silent. What is in `solutions` is sent before the next shot.

    Raises:
        OSError: the bus cannot be opened.
    """
    receiver, begun = CanReceiver(default_interface()), False
    host, sent = Host(default_interface(), unit), 0
    try:
        bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate, fd=fd)
    except Exception as error:  # without its vendor's driver an interface may raise anything
        raise OSError(f"{interface} {channel}: {error}") from None
    print(f"listening on {interface} {channel}", file=sys.stderr, flush=True)
    with bus:
        while (frame := _next_frame(bus)) or not begun:
            if frame is None or frame.is_extended_id:
                continue
            for received in receiver.receive(frame.arbitration_id, bytes(frame.data), frame.is_fd):
                if isinstance(received, Message) and received.unit == unit:
                    begun = True
                    yield received
            while solutions:
                number = sent % _SEQUENCE_NUMBERS
                for part in host.encode_message_frames(NAME, sequence=number, **solutions.pop(0)):
                    with suppress(can.CanError):  # the queue is full: this solution is lost
                        bus.send(
                            can.Message(arbitration_id=part.can_id, data=part.data, is_extended_id=False)
                        )
                sent += 1


def _next_frame(bus: can.BusABC) -> can.Message | None:
    """The next frame; None if the bus is silent. python-can raises on a line of slcan that it met in the middle."""
    while True:
        with suppress(ValueError, LookupError):
            return bus.recv(QUIET_S)

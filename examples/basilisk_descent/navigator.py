"""Land by the lidar alone: read its packets from a serial port, solve for height and velocity, command thrust.

The navigator has the lidar's geometry, the Moon's gravity and its own commands, but no truth.
"""

import argparse
import csv
import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import serial
from command import Command
from estimate import Estimate, solve
from guidance import GRAVITY_MPS2, Guidance

from lidar_protocol import Message, SerialReceiver, default_interface


class Navigator:
    """Computes commands from packets."""

    def __init__(self) -> None:
        self._guidance = Guidance()
        self._estimate: Estimate | None = None
        self._thrust_body_mps2 = np.zeros(3)
        self._time_s = 0.0

    def take(self, message: Message) -> tuple[Command, Estimate | None]:
        """Command for a packet, and the estimate on which it is based; None before the first good packet."""
        time_s = (message.time_ns or 0) * 1e-9
        step_s, self._time_s = time_s - self._time_s, time_s
        self._estimate = solve(message) or self._propagated(step_s)
        if self._estimate is not None:
            self._thrust_body_mps2 = self._guidance.thrust(self._estimate, step_s)
        x, y, z = self._thrust_body_mps2.tolist()
        return Command(message.shot or 0, (x, y, z)), self._estimate

    def _propagated(self, step_s: float) -> Estimate | None:
        """Propagate the estimate by gravity and commanded thrust, if too few beams hit the ground."""
        if self._estimate is None:
            return None
        height_m, up_body, velocity_mps = self._estimate
        acceleration_mps2 = self._thrust_body_mps2 - GRAVITY_MPS2 * up_body
        height_m += self._estimate.climb_mps * step_s
        return Estimate(height_m, up_body, velocity_mps + acceleration_mps2 * step_s)


def messages(port: serial.Serial, receiver: SerialReceiver) -> Iterator[Message]:
    """Yield measurements until the other side closes the port; housekeeping is skipped."""
    with suppress(serial.SerialException):
        while True:
            received = receiver.receive(port.read(max(1, port.in_waiting)))
            yield from (message for message in received if isinstance(message, Message))


def main() -> None:
    """Land, and print statistics of the port."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("port", help="serial device, or the pty that lidar-emu prints")
    options.add_argument("--baud", type=int, default=921_600)
    options.add_argument(
        "--commands", default="127.0.0.1:5601", metavar="HOST:PORT", help="command socket of the simulation"
    )
    options.add_argument("--log", type=Path, metavar="FILE", help="CSV file for the estimates")
    arguments = options.parse_args()
    host, _, number = arguments.commands.rpartition(":")
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver, navigator, rows = SerialReceiver(default_interface()), Navigator(), []
    with link, serial.Serial(arguments.port, arguments.baud) as port:
        for message in messages(port, receiver):
            command, estimate = navigator.take(message)
            link.sendto(command.to_bytes(), (host, int(number)))
            rows.append(row(message, estimate))
    if arguments.log:
        with arguments.log.open("w", newline="") as opened:
            csv.writer(opened).writerows([["time_s", "height_m", "climb_mps", "drift_mps"], *rows])
    print(f"{receiver.counters.messages} packets, {receiver.counters.lost_packets} lost")


def row(message: Message, estimate: Estimate | None) -> Sequence[float]:
    """A row of the log."""
    time_s = (message.time_ns or 0) * 1e-9
    if estimate is None:
        return [time_s]
    return [time_s, estimate.height_m, estimate.climb_mps, float(np.linalg.norm(estimate.drift_body_mps))]


if __name__ == "__main__":
    main()

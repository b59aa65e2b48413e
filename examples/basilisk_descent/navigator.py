"""Lands by the lidar alone: reads its packets from a serial port, solves for height and velocity, commands thrust.

It knows the lidar's beams, the Moon's gravity and its own commands; of truth it knows nothing.
"""

import argparse
import csv
import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from math import cos, radians, sin, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
import serial
from command import Command
from numpy.typing import NDArray

from lidar_protocol import Message, SerialReceiver, default_interface

Array = NDArray[np.float64]
GRAVITY_MPS2 = 1.623
AZIMUTHS_DEG = (45.0, 135.0, 225.0, 315.0)  # of the beams around body z, from x to y
BRAKING_MPS2 = 0.7
SLOW_BELOW_M, SLOWEST_MPS = 10.0, 1.0
STEEPEST_TILT = 0.27  # tangent of 15 degrees


class Estimate(NamedTuple):
    """What four beams say of the ground, along the body's axes."""

    height_m: float
    """Distance from the plane through the four footprints."""
    up_body: Array
    """Its normal."""
    velocity_body_mps: Array

    @property
    def climb_mps(self) -> float:
        """Speed along the normal."""
        return float(self.up_body @ self.velocity_body_mps)

    @property
    def drift_body_mps(self) -> Array:
        """Velocity along the plane."""
        return self.velocity_body_mps - self.climb_mps * self.up_body


class Navigator:
    """From packets to commands."""

    def __init__(self) -> None:
        self._estimate: Estimate | None = None
        self._thrust_body_mps2 = np.zeros(3)
        self._time_s = 0.0

    def take(self, message: Message) -> tuple[Command, Estimate | None]:
        """The command that follows from a packet, and what it follows from; None before the first good packet."""
        time_s = (message.time_ns or 0) * 1e-9
        measured = solve(message, self._estimate)
        self._estimate = measured or self._continued(time_s - self._time_s)
        self._time_s = time_s
        if self._estimate is not None:
            self._thrust_body_mps2 = thrust(self._estimate)
        x, y, z = self._thrust_body_mps2.tolist()
        return Command(message.shot or 0, (x, y, z)), self._estimate

    def _continued(self, step_s: float) -> Estimate | None:
        """By gravity and what the engine was asked for, where too few beams saw the ground."""
        if self._estimate is None:
            return None
        height_m, up, velocity_mps = self._estimate
        acceleration_mps2 = self._thrust_body_mps2 - GRAVITY_MPS2 * up
        height_m += self._estimate.climb_mps * step_s
        return Estimate(height_m, up, velocity_mps + acceleration_mps2 * step_s)


def solve(message: Message, before: Estimate | None) -> Estimate | None:
    """Least squares over the beams with a valid range, and over those with a valid speed; None where they are too few."""
    directions = [_direction(beam["beam_angle_deg"], azimuth) for beam, azimuth in zip(message.beams, AZIMUTHS_DEG)]
    ranged = [(u, beam["range_m"]) for u, beam in zip(directions, message.beams) if beam["range_valid"]]
    timed = [(u, beam["closing_speed_mps"]) for u, beam in zip(directions, message.beams) if beam["speed_valid"]]
    if len(ranged) < 3 or len(timed) < 3:
        return None
    # The plane -up · p = height holds the points p = range u: one linear equation for up / height each.
    points_m = np.array([range_m * u for u, range_m in ranged])
    scaled_up = np.linalg.lstsq(-points_m, np.ones(len(points_m)), rcond=None)[0]
    velocity_mps = np.linalg.lstsq(
        np.array([u for u, _ in timed]), np.array([speed for _, speed in timed]), rcond=None
    )[0]
    height_m = 1 / float(np.linalg.norm(scaled_up))
    return Estimate(height_m, _smoothed(scaled_up * height_m, height_m, before), velocity_mps)


def _direction(angle_deg: float, azimuth_deg: float) -> Array:
    off, around = radians(angle_deg), radians(azimuth_deg)
    return np.array([sin(off) * cos(around), sin(off) * sin(around), cos(off)])


def _smoothed(up: Array, height_m: float, before: Estimate | None) -> Array:
    """Close to the ground the footprints are close together and the plane through them is all noise."""
    if before is None:
        return up
    share = min(1.0, max(0.05, height_m / 50))
    mixed = before.up_body + share * (up - before.up_body)
    return mixed / np.linalg.norm(mixed)


def thrust(estimate: Estimate) -> Array:
    """Thrust per mass: brake at a steady rate to walking pace, and against the drift."""
    above_m = max(0.0, estimate.height_m - SLOW_BELOW_M)
    wanted_climb_mps = -sqrt(SLOWEST_MPS**2 + 2 * BRAKING_MPS2 * above_m)
    ahead_mps2 = BRAKING_MPS2 if above_m > 0 else 0.0
    upward_mps2 = GRAVITY_MPS2 + ahead_mps2 + 0.8 * (wanted_climb_mps - estimate.climb_mps)
    upward_mps2 = min(max(upward_mps2, 0.3 * GRAVITY_MPS2), 2.5 * GRAVITY_MPS2)
    sideways_mps2 = -0.4 * estimate.drift_body_mps
    most_mps2 = STEEPEST_TILT * upward_mps2
    size_mps2 = float(np.linalg.norm(sideways_mps2))
    sideways_mps2 *= min(1.0, most_mps2 / size_mps2) if size_mps2 > 0 else 1.0
    return upward_mps2 * estimate.up_body + sideways_mps2


def messages(port: serial.Serial, receiver: SerialReceiver) -> Iterator[Message]:
    """Packet after packet, until the other side closes the port."""
    with suppress(serial.SerialException):
        while True:
            yield from receiver.receive(port.read(max(1, port.in_waiting)))


def main() -> None:
    """Land, and say what came over the port."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("port", help="serial device, or the pty that lidar-emu prints")
    options.add_argument("--baud", type=int, default=921_600)
    options.add_argument("--commands", default="127.0.0.1:5601", metavar="HOST:PORT", help="of the simulation")
    options.add_argument("--log", type=Path, metavar="FILE", help="the estimates as CSV")
    asked = options.parse_args()
    host, _, number = asked.commands.rpartition(":")
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver, navigator, rows = SerialReceiver(default_interface()), Navigator(), []
    with link, serial.Serial(asked.port, asked.baud) as port:
        for message in messages(port, receiver):
            command, estimate = navigator.take(message)
            link.sendto(command.to_bytes(), (host, int(number)))
            rows.append(row(message, estimate))
    if asked.log:
        with asked.log.open("w", newline="") as opened:
            csv.writer(opened).writerows([["time_s", "height_m", "climb_mps", "drift_mps"], *rows])
    print(f"{receiver.counters.messages} packets, {receiver.counters.lost_packets} lost")


def row(message: Message, estimate: Estimate | None) -> Sequence[float]:
    """A line of the log."""
    time_s = (message.time_ns or 0) * 1e-9
    if estimate is None:
        return [time_s]
    return [time_s, estimate.height_m, estimate.climb_mps, float(np.linalg.norm(estimate.drift_body_mps))]


if __name__ == "__main__":
    main()

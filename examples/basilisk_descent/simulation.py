"""Basilisk flies a lander down to the Moon; a navigator that receives the lidar's packets alone commands its engine.

Run beside `lidar-emu run lander.yaml` and navigator.py, as README.md describes.
"""

import argparse
import csv
import sys
from collections.abc import Iterator
from contextlib import closing
from math import radians
from pathlib import Path
from typing import NamedTuple

import numpy as np
from Basilisk.utilities import RigidBodyKinematics as Rotations
from lidar_link import LidarLink
from live_truth import LAST, TRUTH
from site_frame import Array, SiteFrame
from vehicle import State, Vehicle

import lidar_emu
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene import build_scene

STEP_NS = 10_000_000
FACING_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # body x north, y east, z down
LEG_M = 1.5
"""Distance from the lidar down to the feet."""
LONGEST_S = 200.0
MOON_RADPS = 2.6617e-6
LATITUDE_DEG, LONGITUDE_DEG = 0.67, 23.47
START_SITE_M, START_SITE_MPS = np.array([-150.0, 80.0, 800.0]), np.array([12.0, -7.0, -30.0])
START_TILT_DEG, START_RATE_RADPS = 5.0, np.array([0.01, -0.01, 0.0])
COLUMNS = ["time_s", "height_m", "east_m", "north_m", "up_m", "east_mps", "north_mps", "up_mps"]


class Row(NamedTuple):
    """The true state relative to the ground at an instant, as sent and logged."""

    time_s: float
    position_site_m: Array
    velocity_site_mps: Array
    site_from_body: Array
    """Unit quaternion, scalar first."""
    rate_body_radps: Array
    """Relative to the site."""
    height_m: float
    """Height of the lidar above the ground straight below."""


class Flight:
    """The vehicle above the scenario's ground.

    Args:
        scenario: scenario file, of which only the ground is used.
    """

    def __init__(self, scenario: str, with_clock: bool) -> None:
        loaded = lidar_emu.load(scenario)
        assert isinstance(loaded, FlightScenario), f"{scenario} has no ground"
        self._ground = build_scene(loaded.site)
        radius_m = loaded.site.body.radius_m + self._ground.origin_altitude_m
        self._site = SiteFrame(LATITUDE_DEG, LONGITUDE_DEG, radius_m, MOON_RADPS)
        position_m, velocity_mps = self._site.to_inertial(0.0, START_SITE_M, START_SITE_MPS)
        attitude = (
            Rotations.euler1(radians(START_TILT_DEG)) @ FACING_DOWN @ self._site.site_from_inertial(0.0)
        )
        start = State(position_m, velocity_mps, attitude, START_RATE_RADPS)
        self.vehicle = Vehicle(start, STEP_NS, with_clock)

    def row(self) -> Row:
        """Present state."""
        time_s, state = self.vehicle.time_ns * 1e-9, self.vehicle.state
        position_m, velocity_mps = self._site.to_site(time_s, state.position_m, state.velocity_mps)
        body_from_site = state.body_from_inertial @ self._site.site_from_inertial(time_s).T
        ground_rate_radps = state.body_from_inertial @ self._site.rate_inertial_radps
        ground_m = self._ground.height_m(position_m[:1], position_m[1:2])[0]
        return Row(
            time_s,
            position_m,
            velocity_mps,
            # Basilisk's Euler parameters of the matrix to the body are the quaternion that rotates body vectors to the
            # site frame.
            Rotations.C2EP(body_from_site),
            state.rate_body_radps - ground_rate_radps,
            float(position_m[2] - ground_m),
        )


def truth(row: Row, sequence: int, time_ns: int, last: bool) -> bytes:
    """The datagram. The thrust changes at every truth, so the acceleration is not unique and is left unknown."""
    return TRUTH.pack(
        b"LETR", 1, LAST * last, sequence, time_ns, *row.position_site_m, *row.velocity_site_mps,
        0, 0, 0, *row.site_from_body, *row.rate_body_radps,
    )  # fmt: skip


def fly(flight: Flight, link: LidarLink) -> Iterator[Row]:
    """Fly until the feet touch the ground."""
    landed, sequence = False, 0
    while not landed:
        row = flight.row()
        landed = row.height_m <= LEG_M or row.time_s >= LONGEST_S
        commands = link.exchange(truth(row, sequence, flight.vehicle.time_ns, landed), sequence, landed)
        yield row
        if commands:
            flight.vehicle.command_thrust(commands[-1].thrust_body_mps2)
        if not landed:
            flight.vehicle.step()
        sequence += 1


def write(rows: list[Row], file: Path) -> None:
    """Write one line for each truth."""
    with file.open("w", newline="") as opened:
        table = csv.writer(opened)
        table.writerow(COLUMNS)
        table.writerows(
            [row.time_s, row.height_m, *row.position_site_m, *row.velocity_site_mps] for row in rows
        )


def address(text: str) -> tuple[str, int]:
    """HOST:PORT."""
    host, _, port = text.rpartition(":")
    return host, int(port)


def main() -> int:
    """Fly, and print the touchdown."""
    here = Path(__file__).parent
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--pace", choices=["lockstep", "wall"], default="lockstep")
    options.add_argument(
        "--scenario", default=str(here / "lander.yaml"), help="scenario whose ground the lander descends to"
    )
    options.add_argument("--truth", type=address, default=("127.0.0.1", 5600), metavar="HOST:PORT")
    options.add_argument("--commands", type=address, default=("127.0.0.1", 5601), metavar="HOST:PORT")
    options.add_argument("--log", type=Path, metavar="FILE", help="CSV file for the flight")
    arguments = options.parse_args()
    lockstep = arguments.pace == "lockstep"
    flight = Flight(arguments.scenario, with_clock=not lockstep)
    try:
        with closing(LidarLink(arguments.truth, arguments.commands, lockstep)) as link:
            rows = list(fly(flight, link))
    except OSError as error:  # The socket is in use, or there was no reply.
        print(f"simulation: {error}", file=sys.stderr)
        return 1
    if arguments.log:
        write(rows, arguments.log)
    end = rows[-1]
    east, north, up = end.velocity_site_mps
    print(f"{end.time_s:.2f} s: {end.height_m:.2f} m above the ground, descending at {-up:.2f} m/s, "
          f"drifting at {np.hypot(east, north):.2f} m/s")  # fmt: skip
    return 0 if end.height_m <= LEG_M else 1


if __name__ == "__main__":
    sys.exit(main())

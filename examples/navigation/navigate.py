"""Navigate by the packets of `lidar-emu run` in another process, send the solutions back, and print the truth beside
the estimate."""

import argparse
import sys
from collections.abc import Iterator
from math import acos, degrees

import numpy as np
from beams import Array, Shot, from_message
from error_state import POSITION, VELOCITY
from navigation import Navigator, UpdateResult
from ports import from_can, from_serial
from solution import Solution, solution
from trials import errors, start
from trust import NAMED
from truth import Truth

import lidar_emu
from lidar_emu.errors import InputError
from lidar_protocol import Message

HEADINGS = (
    "           height, m           error of velocity, mm/s     tilt, deg    beams used \n"
    "   time     true estimate      east    north       up    true   est.   range  speed\n"
)


def main() -> None:
    """Read the command line, and follow the flight."""
    arguments = options().parse_args()
    try:
        truth = Truth(lidar_emu.load(arguments.scenario, overrides(arguments.set)))
        solutions: list[Solution] = []
        arriving = messages(arguments, truth.scenario.wire.unit, solutions)
        follow(truth, arriving, arguments, solutions)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def options() -> argparse.ArgumentParser:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", help="the scenario that lidar-emu run flies")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="the same as for lidar-emu run"
    )
    parser.add_argument("--port", metavar="PATH", help="serial device, or the pty that lidar-emu prints")
    parser.add_argument("--baud", type=natural, default=921_600)
    parser.add_argument("-i", "--interface", metavar="NAME", help="python-can interface name, e.g. socketcan")
    parser.add_argument("-c", "--channel", metavar="NAME", help="CAN channel, e.g. vcan0")
    parser.add_argument("--bitrate", type=natural, default=500_000)
    parser.add_argument("--fd", action="store_true", help="CAN FD frames")
    parser.add_argument("--rules", choices=NAMED, default="careful", help="rules for accepting measurements")
    parser.add_argument("--seed", type=natural, default=1, help="seed of inertial unit and initial errors")
    parser.add_argument("--every", type=float, default=1.0, metavar="S", help="flight time between two lines")
    return parser


def natural(text: str) -> int:
    """Nonnegative integer, for argparse."""
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is not usable; must be an integer, 0 or more")
    return int(text)


def overrides(settings: list[str]) -> dict[str, str]:
    """Key and value pairs of `--set`."""
    pairs = [each.partition("=") for each in settings]
    for key, equals, value in pairs:
        if not (key and equals and value):
            raise InputError("--set", None, key + equals + value, "must be KEY=VALUE")
    return {key: value for key, _, value in pairs}


def messages(arguments: argparse.Namespace, unit: int, solutions: list[Solution]) -> Iterator[Message]:
    """Messages from the given port, which sends the solutions back."""
    if arguments.port is not None and arguments.interface is None:
        return from_serial(arguments.port, arguments.baud, unit, solutions)
    if arguments.port is not None or None in (arguments.interface, arguments.channel):
        raise InputError(
            "--port", None, arguments.port, "must be either --port, or --interface and --channel"
        )
    return from_can(arguments.interface, arguments.channel, arguments.bitrate, arguments.fd, unit, solutions)


def follow(
    truth: Truth, arriving: Iterator[Message], arguments: argparse.Namespace, solutions: list[Solution]
) -> None:
    """Navigate to the end of the flight, with a solution for each shot, and print the error there."""
    shots = (shot for message in arriving if (shot := from_message(message, truth.sheet)) is not None)
    first = next(shots, None)
    if first is None:
        raise OSError("no packet received")
    navigator = start(truth, first.time_ns, arguments.seed, NAMED[arguments.rules])
    printed_ns, used, unused = -1.0, 0, 0
    print(HEADINGS, end="")
    for shot in shots:
        result = navigator.take(shot)
        if result is None:
            unused += 1
            continue
        used += 1
        solutions.append(solution(navigator, shot, result))
        restarted = [
            what for what, each in zip(("height", "velocity"), result, strict=True) if each.reinitialised
        ]
        if restarted or shot.time_ns >= printed_ns:
            printed_ns = shot.time_ns + arguments.every * 1e9
            print(
                line(truth, navigator, shot, result),
                *(f"{what} reinitialised" for what in restarted),
                flush=True,
            )
    off = errors(navigator.state, truth.at(navigator.time_ns))
    east_m, north_m, height_m = off[POSITION]
    speed_mmps = np.linalg.norm(off[VELOCITY]) * 1e3
    print(
        f"error at the end, {navigator.time_ns * 1e-9:.2f} s: {east_m:+.2f} m east, {north_m:+.2f} m north,"
        f" {height_m:+.2f} m of height, {speed_mmps:.1f} mm/s; {used} shots used, {unused} not used"
    )


def line(truth: Truth, navigator: Navigator, shot: Shot, result: tuple[UpdateResult, UpdateResult]) -> str:
    """One line of output: truth and estimate at a shot."""
    true, state = truth.at(shot.time_ns), navigator.state
    east, north, up = errors(state, true)[VELOCITY] * 1e3
    reach_m = true.position_site_m[2] * float(np.nanmax(np.hypot(*shot.directions_body[:, :2].T)))
    true_deg = tilt_deg(true.site_from_body, truth.slope(shot.time_ns, reach_m))
    ranges, speeds = result
    return (
        f"{shot.time_ns * 1e-9:7.2f} {true.position_site_m[2]:8.2f} {state.height_m:8.2f}"
        f"  {east:+8.1f} {north:+8.1f} {up:+8.1f}"
        f"  {true_deg:6.2f} {tilt_deg(state.site_from_body, state.slope):6.2f}"
        f"   {ranges.accepted} of {ranges.valid} {speeds.accepted} of {speeds.valid}"
    )


def tilt_deg(site_from_body: Array, slope: Array) -> float:
    """Angle between body z and the normal of the ground."""
    down = np.append(slope, -1.0)
    return degrees(acos(min(1.0, float(site_from_body[:, 2] @ down / np.linalg.norm(down)))))


if __name__ == "__main__":
    main()

"""A navigator for tests of trials: velocity and height by least squares, shot by shot, with a mistake on request.

    python navigator.py SCENARIO PORT [MISTAKE]

PORT is the path of a pty or udp:HOST:PORT. It knows attitude and position from the scenario, as from an ideal inertial
unit, and finds a beam that disagrees with the others by leaving each out in turn.
"""

from __future__ import annotations

import itertools
import select
import socket
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import serial

import lidar_emu
from lidar_emu.beams.flight import Flight
from lidar_emu.numerics.vector_arrays import rotate
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.wire import interface_named
from lidar_protocol import Host, Message, SerialReceiver, default_interface

MISTAKES = ("none", "frozen clock", "sign of a beam", "no gate", "overconfident", "ignores validity", "hangs",
            "floods", "sends NaN", "perfect")  # fmt: skip
FIELDS = default_interface().commands.messages_by_name["navigation"].arguments
SIGMA_MPS, SIGMA_M, GATE = 0.02, 1.0, 8.0
"""Sigmas by which a snapshot is off, of quantisation, speckle and slopes; the gate is in these sigmas."""


def line(port: str) -> tuple[Iterator[bytes], Callable[[bytes], Any]]:
    """What arrives, until the other side hangs up, and how to send."""
    if port.startswith("udp:"):
        host, _, number = port.removeprefix("udp:").rpartition(":")
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind((host, int(number)))
        print("ready", flush=True)
        device: list[Any] = []

        def datagrams() -> Iterator[bytes]:
            while True:
                data, source = sock.recvfrom(4096)
                device[:] = [source]
                yield data

        return datagrams(), lambda data: sock.sendto(data, device[0])
    opened = serial.Serial(port, 921_600, timeout=None)

    def read() -> Iterator[bytes]:
        while True:
            select.select([opened], [], [])
            yield opened.read(max(1, opened.in_waiting))

    return read(), opened.write


def used_beams(axes: np.ndarray, value: np.ndarray, sigma: float, gate: bool) -> np.ndarray:
    """Beams that agree on a vector whose components along the axes are the values."""
    known = np.isfinite(value)
    if not gate or known.sum() < 4:
        return known

    def worst(chosen: np.ndarray) -> float:
        solved = np.linalg.lstsq(axes[chosen], value[chosen], rcond=None)[0]
        return float(np.abs(axes[chosen] @ solved - value[chosen]).max())

    if worst(known) <= GATE * sigma:
        return known
    candidates = [known & (np.arange(len(known)) != beam) for beam in np.flatnonzero(known)]
    return min(candidates, key=lambda chosen: np.abs(np.median(value[known]) - value[chosen]).max())


def heights(axes: np.ndarray, range_m: np.ndarray, gate: bool) -> tuple[float, np.ndarray]:
    """Height above level ground, and the beams that agree on it."""
    height_m = -axes[:, 2] * range_m
    known = np.isfinite(height_m)
    if not known.any():
        return np.nan, known
    middle = np.median(height_m[known])
    used = known & (np.abs(height_m - middle) <= GATE * SIGMA_M) if gate else known
    return (float(height_m[used].mean()) if used.any() else np.nan), used


def solution(message: Message, flight: Flight, mistake: str, rng: np.random.Generator) -> dict[str, Any]:
    """The navigation message that answers a shot."""
    state = flight.trajectory.state(np.array([message.time_ns * 1e-9]))
    pattern = int(np.argmin(np.abs(flight.scanner.angle_deg[:, 0] - message.beams[0]["beam_angle_deg"])))
    axes = rotate(state.site_from_body, flight.scanner.published_sensor[pattern])
    gate, blind = mistake not in ("no gate", "ignores validity"), mistake == "ignores validity"
    column = {
        (name, flag): np.array(
            [b[name] if (b[flag] or blind) and b[name] is not None else np.nan for b in message.beams],
            dtype=float,
        )
        for name, flag in (("range_m", "range_valid"), ("closing_speed_mps", "speed_valid"))
    }
    range_m, speed_mps = column.values()
    if mistake == "sign of a beam":
        speed_mps[2] *= -1
        gate = False
    height_m, range_used = heights(axes, range_m, gate)
    speed_used = used_beams(axes, speed_mps, SIGMA_MPS, gate)
    values: dict[str, Any] = dict.fromkeys(FIELDS)
    values |= {name: "not_judged" for name in FIELDS if "_trust_" in name}
    if speed_used.sum() >= 3:
        velocity = np.linalg.lstsq(axes[speed_used], speed_mps[speed_used], rcond=None)[0]
        spread = SIGMA_MPS * np.sqrt(np.diag(np.linalg.inv(axes[speed_used].T @ axes[speed_used])))
    else:
        velocity, spread = np.full(3, np.nan), np.full(3, np.nan)
    sigma_m = SIGMA_M
    if mistake in ("perfect", "overconfident"):
        velocity = state.velocity_site_mps[0] + SIGMA_MPS * rng.standard_normal(3)
        east_m, north_m, up_m = state.position_site_m[0]
        ground_m = flight.scene.height_m(np.array([east_m]), np.array([north_m]))[0]
        height_m, spread = up_m - ground_m + SIGMA_M * rng.standard_normal(), np.full(3, SIGMA_MPS)
    if mistake == "overconfident":
        spread, sigma_m = spread / 10, sigma_m / 10
    values |= {
        "time_ns": message.time_ns,
        "mode": "aided",
        "altitude_m": height_m,
        "sigma_altitude_m": sigma_m,
    }
    for axis, name in enumerate(("east", "north", "up")):
        values[f"velocity_{name}_mps"] = velocity[axis]
        values[f"sigma_velocity_{name}_mps"] = spread[axis]
    for quantity, used, given in (("range", range_used, range_m), ("speed", speed_used, speed_mps)):
        for beam in range(len(used)):
            word = "used" if used[beam] else "gated" if np.isfinite(given[beam]) else "invalid"
            values[f"{quantity}_trust_{beam}"] = word
    return values


def main(scenario: str, port: str, mistake: str = "none", *settings: str) -> None:
    """Answer every shot."""
    changes = dict(text.split("=", 1) for text in settings)
    loaded = lidar_emu.load(scenario, changes)
    assert isinstance(loaded, FlightScenario)
    flight, rng = Flight(loaded), np.random.default_rng(1)
    interface = interface_named(loaded.wire.interface, scenario)
    host, receiver, first_ns = Host(interface), SerialReceiver(interface), None
    arriving, send = line(port)
    sequence = itertools.count()
    for data in arriving:
        for message in receiver.receive(data):
            if not isinstance(message, Message) or message.time_ns is None:
                continue
            first_ns = message.time_ns if first_ns is None else first_ns
            late = message.time_ns - first_ns > 2e9
            if mistake == "hangs" and late:
                select.select([], [], [])
            values = solution(message, flight, mistake, rng)
            if mistake == "frozen clock" and late:
                values["time_ns"] = first_ns + 2_000_000_000
            packet = host.encode_message("navigation", sequence=next(sequence) % 256, **values)
            if mistake == "sends NaN" and late:
                packet = packet[:20] + b"\xff" * 20 + packet[40:]
            for _ in range(200 if mistake == "floods" and late else 1):
                send(packet)


if __name__ == "__main__":
    main(*sys.argv[1:])

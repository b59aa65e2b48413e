"""A lander for tests of closed loops: it flies down by what the lidar on its port measures, and sends its true state.

    python lander.py PORT TRUTH [wall|lockstep] [MISTAKE]

TRUTH is HOST:PORT. Height and vertical speed are predicted with the thrust that it commands, and corrected by each
packet; the answer is the `navigation` message.
"""

from __future__ import annotations

import itertools
import os
import select
import socket
import sys
import time
from math import cos, radians
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
import live_truth

from lidar_protocol import Host, Message, SerialReceiver, default_interface

STEP_S, GRAVITY_MPS2, LARGEST_MPS2, TOUCHDOWN_M, GAIN = 0.01, 1.62, 6.0, 0.3, 0.3
STEPS_BEFORE = 100
"""Steps before it dies or hangs."""
FIELDS = default_interface().commands.messages_by_name["navigation"].arguments


class Lander:
    """True motion along the vertical, and the estimate of it.

    Args:
        mistake: `sign of the speed` of all beams, which gives it no reason to brake; `dies`; `hangs`; empty: none.
    """

    def __init__(self, port: int, mistake: str) -> None:
        self.port, self.mistake = port, mistake
        self.up_m, self.climb_mps, self.acceleration_mps2 = 30.0, -10.0, 0.0
        self.height_m, self.estimated_mps = 35.0, -9.0
        self.receiver, self.host = SerialReceiver(default_interface()), Host(default_interface())
        self.numbers, self.received = itertools.count(), 0

    def step(self) -> None:
        """Fly a step, in truth and in the estimate."""
        wanted_mps2 = 2 * (-1 - 0.3 * self.height_m - self.estimated_mps)
        self.acceleration_mps2 = min(max(wanted_mps2, -GRAVITY_MPS2), LARGEST_MPS2)
        for height, speed in (("up_m", "climb_mps"), ("height_m", "estimated_mps")):
            at_mps = getattr(self, speed)
            setattr(
                self, height, getattr(self, height) + STEP_S * (at_mps + self.acceleration_mps2 * STEP_S / 2)
            )
            setattr(self, speed, at_mps + self.acceleration_mps2 * STEP_S)

    def read(self, limit_s: float) -> None:
        """Take in what has arrived, or arrives within the limit; answer each packet."""
        if not select.select([self.port], [], [], max(limit_s, 0))[0]:
            return
        for message in self.receiver.receive(os.read(self.port, 4096)):
            if isinstance(message, Message):
                self.received += 1
                self.correct(message)
                self.answer(message)

    def correct(self, message: Message) -> None:
        sign = -1 if self.mistake == "sign of the speed" else 1
        for beam in message.beams:
            along = cos(radians(beam["beam_angle_deg"] or 0.0))
            if beam["range_valid"]:
                self.height_m += GAIN * (beam["range_m"] * along - self.height_m)
            if beam["speed_valid"]:
                self.estimated_mps += GAIN * (-sign * beam["closing_speed_mps"] / along - self.estimated_mps)

    def answer(self, message: Message) -> None:
        values = dict.fromkeys(FIELDS) | {name: "used" for name in FIELDS if "_trust_" in name}
        values |= {"time_ns": message.time_ns, "mode": "aided", "altitude_m": self.height_m}
        values |= {"velocity_east_mps": 0.0, "velocity_north_mps": 0.0, "velocity_up_mps": self.estimated_mps}
        os.write(
            self.port, self.host.encode_message("navigation", sequence=next(self.numbers) % 256, **values)
        )

    def truth(self, number: int) -> bytes:
        last = live_truth.LAST if self.up_m <= TOUCHDOWN_M else 0
        return live_truth.TRUTH.pack(
            b"LETR", 1, live_truth.ACCELERATION_KNOWN | last, number, round(number * STEP_S * 1e9),
            0, 0, self.up_m, 0, 0, self.climb_mps, 0, 0, self.acceleration_mps2, *live_truth.FACING_DOWN, 0, 0, 0,
        )  # fmt: skip


def main(port: str, address: str, pace: str = "wall", mistake: str = "") -> None:
    """Fly until touchdown."""
    lander = Lander(os.open(port, os.O_RDWR | os.O_NOCTTY), mistake)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    host, _, number = address.rpartition(":")
    link.connect((host, int(number)))
    link.settimeout(1)
    start_s, due = time.monotonic(), 0
    for step in itertools.count():
        if step == STEPS_BEFORE and mistake in ("dies", "hangs"):
            if mistake == "hangs":
                select.select([], [], [])
            print("no fuel")
            return
        live_truth.send(link, datagram := lander.truth(step))
        if pace == "lockstep":
            while (packets := live_truth.packets_of(link, step)) is None:
                live_truth.send(link, datagram)
            due += len(packets)
            while lander.received < due:
                lander.read(1)
        else:
            while (left_s := start_s + (step + 1) * STEP_S - time.monotonic()) > 0:
                lander.read(left_s)
        if lander.up_m <= TOUCHDOWN_M:
            return
        lander.step()


if __name__ == "__main__":
    main(*sys.argv[1:])

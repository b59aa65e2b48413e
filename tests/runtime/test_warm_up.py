"""A warm-up leaves no trace: it changes neither the packets nor the report on the truth."""

from __future__ import annotations

import json
from collections import deque
from typing import Any

import lidar_emu
from lidar_emu.faults.packets import faulty_encoder
from lidar_emu.runtime.feed.live_truth_source import TruthSource
from lidar_emu.runtime.observer import Observer
from lidar_emu.session import Session
from lidar_emu.shots.model import build_model
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.live_datagram import Truth
from lidar_emu.wire import Encoder

STILL = (0.0, 0.0, 0.0)
MS = 1_000_000


def session() -> Session:
    """With beams that switch in flight, and faults that carry something from shot to shot."""
    faults = [
        {"kind": "stuck", "from_s": 0.2, "probability": 0.3},
        {"kind": "drift", "range_mps": 1.0},
        {"kind": "frozen_counter", "probability": 0.2},
        {"kind": "reordered", "probability": 0.3},
    ]
    settings = {"level": "geometric", "timing.rate_hz": "20", "duration_s": "5", "faults": json.dumps(faults)}
    scenario = lidar_emu.load("descent.yaml", settings)
    encoder = Encoder(scenario.wire, False, False, 4)
    return Session(build_model(scenario), encoder, 200, faulty_encoder(scenario, encoder, False))


def packets(one: Session, warming: bool) -> list[Any]:
    sent: list[Any] = []
    rewound = False
    while True:
        if warming:
            one.warm_up()
        block = one.shoot(1)
        if block is None:
            return sent
        sent += zip(block.packets, block.due_ns, strict=True)
        if warming and len(sent) == 40 and not rewound:
            rewound = True
            one.rewind(25)
            del sent[25:]


def test_packets_are_the_same_with_and_without() -> None:
    plain = packets(session(), warming=False)
    assert len(plain) == 100
    assert packets(session(), warming=True) == plain


class Socket:
    def __init__(self, *datagrams: tuple[bytes, int]) -> None:
        self._waiting = deque(datagrams)

    def receive(self, most: int = 64) -> list[tuple[bytes, int, str]]:
        count = min(most, len(self._waiting))
        return [(*self._waiting.popleft(), "simulator") for _ in range(count)]


class Listener(Observer):
    def __init__(self) -> None:
        self.heard: list[tuple[bytes, int, bool]] = []

    def on_truth(self, datagram: bytes, time_ns: int, counted: bool) -> None:
        self.heard.append((datagram, time_ns, counted))


def test_observers_hear_of_each_datagram_once_and_when_there_is_time() -> None:
    truths = [
        Truth(k, k * 10 * MS, (0.0, 0.0, 900.0), STILL, STILL, (1.0, 0.0, 0.0, 0.0), STILL) for k in range(3)
    ]
    datagrams = [*(truth.to_bytes() for truth in truths), b"no truth"]
    socket: Any = Socket(*((data, 500 * MS + k * 10 * MS) for k, data in enumerate(datagrams)))
    listener = Listener()
    source = TruthSource(socket, LiveTrajectory(100 * MS), 100 * MS, [], [listener])
    source.warm_up()
    source.receive(1)
    source.begin(500 * MS)
    source.warm_up()
    assert listener.heard == []
    source.notify()
    assert listener.heard == [(datagrams[0], 0, True)]
    source.receive(1)
    source.warm_up()
    source.receive()
    source.notify()
    source.notify()
    assert listener.heard == [(data, k * 10 * MS, k < 3) for k, data in enumerate(datagrams)]
    assert source.newest == truths[-1]
    counted = source.to_json()["datagrams"]
    assert {name: count for name, count in counted.items() if count} == {"accepted": 3, "malformed": 1}

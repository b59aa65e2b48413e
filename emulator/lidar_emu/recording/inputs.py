"""What came in while a recorded run was flown, as its shots followed it."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from lidar_emu.device.machine import initial
from lidar_emu.device.now import DeviceNow
from lidar_emu.device.obey import Order
from lidar_emu.device.rules import all_events
from lidar_emu.faults.encoder import faulty_packets
from lidar_emu.recording import channels
from lidar_emu.recording.read import Recording, Told
from lidar_emu.runtime.feed.on_command import waiting_device
from lidar_emu.scenario.faults.on_order import read_fault
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Session
from lidar_emu.shots.model import Model
from lidar_emu.trajectory.live_datagram import Truth
from lidar_emu.wire import Encoder

if TYPE_CHECKING:
    from lidar_emu.trajectory.live import LiveTrajectory


class Changes:
    """Accepted commands and faults ordered in flight, fed to a session before the shots that followed them.

    Args:
        recording: of the run.
        scenario: what is flown.
        model: of the scenario.
        encoder: of the packets.
        can: whether the link was a CAN bus.
        session: computes the shots anew.
    """

    def __init__(
        self,
        recording: Recording,
        scenario: FlightScenario | BenchScenario,
        model: Model,
        encoder: Encoder,
        can: bool,
        session: Session,
    ) -> None:
        self._scenario, self._model, self._encoder, self._can = scenario, model, encoder, can
        self._session = session
        told = recording.told(channels.COMMAND, channels.ORDERED_FAULT)
        followed = [each for each in told if _changes_shots(each)]
        waited_ns = recording.origin.get("waited_ns")
        if waited_ns is None:
            self._device = DeviceNow(session.rules, initial(session.rules))
        else:
            self._device = waiting_device(session.rules)
            followed = self._before_the_flight(followed, int(waited_ns))
        self._waiting = deque(followed)

    @property
    def next_shot(self) -> int | None:
        """The first shot that follows the next of them; None: there is none left."""
        return self._waiting[0].values["first_shot"] if self._waiting else None

    def follow(self) -> None:
        """Let the session's next shot follow all that it is the first to follow."""
        while (shot := self.next_shot) is not None and shot <= self._session.next_shot:
            self._apply(self._waiting.popleft(), 0)

    def _before_the_flight(self, followed: list[Told], waited_ns: int) -> list[Told]:
        """Times count from power-up up to the command that began the flight; returns what came later."""
        count = 1 + max((k for k, each in enumerate(followed) if each.time_ns < 0), default=-1)
        for each in followed[:count]:
            self._apply(each, waited_ns)
        self._session.use_device(self._device.begin_flight(self._session.rules, waited_ns))
        return followed[count:]

    def _apply(self, told: Told, zero_ns: int) -> None:
        if told.topic == channels.ORDERED_FAULT.topic:
            self._order(told.values["order"], is_flying=zero_ns == 0)
            return
        command, tone_ns = told.values, told.values["tone_ns"]
        time_ns = told.time_ns + zero_ns
        tone_ns = time_ns if tone_ns is None else tone_ns
        state, _ = self._device.obey(Order(command["command"], command["values"], time_ns, tone_ns))
        if state is not None:
            self._session.use_device(state)

    def _order(self, order: dict[str, Any], is_flying: bool) -> None:
        fault = read_fault(json.dumps(order))
        faults = [*self._scenario.faults, fault]
        self._scenario = self._scenario.model_copy(update={"faults": faults})
        faulty = faulty_packets(self._scenario, self._encoder, self._can)
        events = all_events(self._scenario.device, faults)
        self._session.use_faults(self._model.with_faults(faults), faulty, events)
        if is_flying:
            self._device.expect(events)


class LiveTruths:
    """The truth that a simulator sent, given to the trajectory as far as each shot has used it.

    Args:
        recording: of the run.
        trajectory: of the model that computes the shots anew.
    """

    def __init__(self, recording: Recording, trajectory: LiveTrajectory) -> None:
        self._trajectory = trajectory
        self._truths = self._read(recording)
        self._used_ns: dict[int, int | None] = {
            told.values["shot"]: told.values.get("truth_time_ns") for told in recording.told(channels.TRUTH)
        }

    def give(self, shot: int, seen_ns: int) -> int | None:
        """Give what a shot was computed from; returns the time of the newest truth, None if that is not known.

        Args:
            shot: number of the shot.
            seen_ns: scenario time up to which it depends on the vehicle's motion.
        """
        if shot not in self._used_ns:
            return None
        used_ns = self._used_ns[shot]
        while (newest := self._trajectory.newest) is None or newest.time_ns < (
            seen_ns if used_ns is None else used_ns
        ):
            truth = next(self._truths, None)
            if truth is None:
                return None
            self._trajectory.accept(truth, truth.time_ns)
        return newest.time_ns

    @staticmethod
    def _read(recording: Recording) -> Iterator[Truth]:
        for _, datagram in recording.said(channels.LIVE_TRUTH):
            truth = Truth.from_bytes(datagram)
            if truth is not None:
                yield truth


def _changes_shots(told: Told) -> bool:
    ordered = told.topic == channels.ORDERED_FAULT.topic
    return told.values["first_shot"] is not None and (ordered or told.values["verdict"] == "accepted")

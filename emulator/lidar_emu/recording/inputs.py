"""Inputs of a recorded run, applied again before the shots that they affected."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from lidar_emu.device.commands import DeviceCommand
from lidar_emu.device.constants import events_of
from lidar_emu.device.modes import initial
from lidar_emu.device.timeline import DeviceTimeline
from lidar_emu.faults.encoder import faulty_encoder
from lidar_emu.recording import channels
from lidar_emu.recording.json_messages import JsonMessage
from lidar_emu.recording.read import Recording
from lidar_emu.runtime.start_conditions import waiting_device
from lidar_emu.scenario.faults.injected import read_fault
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Session
from lidar_emu.shots.model import Model
from lidar_emu.trajectory.live_datagram import Truth
from lidar_emu.wire import Encoder

if TYPE_CHECKING:
    from lidar_emu.trajectory.live import LiveTrajectory


class RecordedInputs:
    """Accepted commands and injected faults, applied to a session before the shots that they affect.

    Args:
        recording: recording of the run.
        scenario: scenario of the run.
        model: model of the scenario.
        encoder: encoder of the packets.
        can: whether the link was a CAN bus.
        session: session that computes the shots again.
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
        inputs = recording.json_messages(channels.COMMAND, channels.INJECTED_FAULT)
        effective = [each for each in inputs if _affects_shots(each)]
        waited_ns = recording.origin.get("waited_ns")
        if waited_ns is None:
            self._device = DeviceTimeline(session.constants, initial(session.constants))
        else:
            self._device = waiting_device(session.constants)
            effective = self._apply_before_flight(effective, recording.of_origin("waited_ns", int))
        self._pending = deque(effective)

    @property
    def next_shot(self) -> int | None:
        """First shot that the next pending input affects; None: no input is pending."""
        return self._pending[0].values["first_shot"] if self._pending else None

    def apply_due(self) -> None:
        """Apply all inputs that affect the session's next shot."""
        while (shot := self.next_shot) is not None and shot <= self._session.next_shot:
            self._apply(self._pending.popleft(), 0)

    def _apply_before_flight(self, inputs: list[JsonMessage], waited_ns: int) -> list[JsonMessage]:
        """Apply the inputs up to the command that began the flight, with times from power-up; return the others."""
        count = 1 + max((k for k, each in enumerate(inputs) if each.time_ns < 0), default=-1)
        for each in inputs[:count]:
            self._apply(each, waited_ns)
        self._session.use_device(self._device.start_flight(self._session.constants, waited_ns))
        return inputs[count:]

    def _apply(self, message: JsonMessage, zero_ns: int) -> None:
        if message.topic == channels.INJECTED_FAULT.topic:
            self._inject(message.values["definition"], is_flying=zero_ns == 0)
            return
        command, tone_ns = message.values, message.values["tone_ns"]
        time_ns = message.time_ns + zero_ns
        tone_ns = time_ns if tone_ns is None else tone_ns
        state, _ = self._device.execute(
            DeviceCommand(command["command"], command["values"], time_ns, tone_ns)
        )
        if state is not None:
            self._session.use_device(state)

    def _inject(self, definition: dict[str, Any], is_flying: bool) -> None:
        fault = read_fault(json.dumps(definition))
        faults = [*self._scenario.faults, fault]
        self._scenario = self._scenario.model_copy(update={"faults": faults})
        faulty = faulty_encoder(self._scenario, self._encoder, self._can)
        events = events_of(faults)
        self._session.use_faults(self._model.with_faults(faults), faulty, events)
        if is_flying:
            self._device.use_events(events)


class RecordedTruth:
    """Recorded live truth, passed to the trajectory up to the sample that each shot used.

    Args:
        recording: recording of the run.
        trajectory: trajectory of the model that computes the shots again.
    """

    def __init__(self, recording: Recording, trajectory: LiveTrajectory) -> None:
        self._trajectory = trajectory
        self._truths = self._read(recording)
        self._taken = 0
        self._known: dict[int, int | None] = {
            truth.values["shot"]: truth.values.get("truth_count")
            for truth in recording.json_messages(channels.TRUTH)
        }

    def give(self, shot: int, seen_ns: int) -> int | None:
        """Pass the truths that a shot knew to the trajectory; in lockstep, the truths that it needs.

        Args:
            shot: number of the shot.
            seen_ns: scenario time up to which the shot depends on the vehicle's motion.

        Returns:
            Scenario time of the newest sample of truth; None if the recording does not hold it.
        """
        if shot not in self._known:
            return None
        known = self._known[shot]
        while (newest := self._trajectory.newest) is None or (
            newest.time_ns < seen_ns if known is None else self._taken < known
        ):
            truth = next(self._truths, None)
            if truth is None:
                return None
            self._trajectory.take(truth)
            self._taken += 1
        return newest.time_ns

    @staticmethod
    def _read(recording: Recording) -> Iterator[Truth]:
        for _, datagram in recording.raw_messages(channels.LIVE_TRUTH):
            truth = Truth.from_bytes(datagram)
            if truth is not None:
                yield truth


def _affects_shots(message: JsonMessage) -> bool:
    injected = message.topic == channels.INJECTED_FAULT.topic
    return message.values["first_shot"] is not None and (injected or message.values["verdict"] == "accepted")

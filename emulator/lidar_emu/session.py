"""The emulated device without clock and port: it computes measurements and packets, shot by shot."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lidar_emu.beams.patterns import ScannerState
from lidar_emu.device.modes import Settling, ShotPolicy, advance, initial, shot_policy, timed
from lidar_emu.device.state import DeviceConstants, DeviceState, TimedEvent, device_constants
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray
from lidar_emu.scenario.device import DeviceBehaviour
from lidar_emu.shots.model import Model, ModelState, initial_state, measure
from lidar_emu.wire import Encoder, Packet

if TYPE_CHECKING:
    from lidar_emu.beams.flight import Flight
    from lidar_emu.faults.packets import FaultyEncoder, WireState
    from lidar_emu.faults.schedule import FaultOccurrence


_NOT_SETTLING = Settling()


@dataclass(frozen=True)
class Block:
    """Consecutive shots, measured and encoded, during which the device's state was constant."""

    measurement: Measurement
    packets: list[Packet]
    """One packet per shot; empty where a fault removed it or the device sends none."""
    due_ns: list[int]
    """Due times of the packets, from the measurement unless a fault delays them."""
    faults: tuple[FaultOccurrence, ...] = ()
    """Faults that acted on these shots."""
    silent: bool = False
    """Whether the device fires no beams and sends no measurements."""
    held: frozenset[int] = frozenset()
    """Shots whose packet a fault holds back, and sends with the next one."""

    def part(self, first: int, end: int) -> Block:
        """Select rows `first` to `end - 1`."""
        if (first, end) == (0, len(self.packets)):
            return self
        start = int(self.measurement.shot[0])
        return replace(
            self,
            measurement=self.measurement.part(first, end),
            packets=self.packets[first:end],
            due_ns=self.due_ns[first:end],
            faults=tuple(fault for fault in self.faults if start + first <= fault.shot < start + end),
        )


class _State(NamedTuple):
    model: ModelState
    shot_policy: ShotPolicy
    unnumbered: int
    """Shots of the scenario without a number in the device's counter: before its last restart, or silent."""
    settling: Settling
    wire: WireState | None


class Session:
    """Measures and encodes the shots of a model, in order.

    Args:
        model: measures the shots.
        encoder: encodes the packets.
        kept_blocks: number of blocks by which `rewind` can go back.
        faulty: encoder with packet faults; None: without packet faults.
        constants: constants of the device; None: the device is in mode track from the first shot on.
    """

    def __init__(
        self,
        model: Model,
        encoder: Encoder,
        kept_blocks: int = 1,
        faulty: FaultyEncoder | None = None,
        constants: DeviceConstants | None = None,
    ) -> None:
        self._model = model
        self._encoder = encoder
        self._faulty = faulty
        self.constants = constants or device_constants(
            DeviceBehaviour(), 1e9 / model.period_ns, model.beam_count, 1
        )
        """Constants of the device."""
        self._state = _State(
            initial_state(model),
            shot_policy(initial(self.constants), model.beam_count),
            0,
            _NOT_SETTLING,
            None if faulty is None else faulty.initial,
        )
        self._before: deque[tuple[int, _State]] = deque(maxlen=kept_blocks)
        self.next_shot = 0
        """Number of the next shot to compute."""

    @property
    def device(self) -> DeviceState:
        """State of the device after the last shot, or after the last command that followed it."""
        return self._state.shot_policy.device

    @property
    def flight(self) -> Flight:
        """Flight of the model, which is no bench pattern."""
        assert self._model.flight is not None
        return self._model.flight

    @property
    def period_ns(self) -> int:
        return self._model.period_ns

    @property
    def is_over(self) -> bool:
        return self.next_shot >= self._model.shot_count

    def next_is_silent(self) -> bool:
        """Whether the device sends nothing in the next shot."""
        return self._advance(1)[1]

    def use_device(self, device: DeviceState) -> None:
        """Use the state of the device after a command, from the next shot on."""
        device = timed(self.constants, device)  # the command may be older than an injected fault
        state, settings = self._state, device.settings
        scanner, unnumbered = state.model.scanner, state.unnumbered
        if scanner.commanded != settings.pattern:
            scanner = replace(scanner, commanded=settings.pattern)
        if device.restarts != self.device.restarts:
            unnumbered = self.next_shot
        self._state = state._replace(
            model=state.model._replace(scanner=scanner),
            shot_policy=shot_policy(device, self._model.beam_count),
            unnumbered=unnumbered,
        )

    def use_faults(
        self, model: Model, faulty: FaultyEncoder | None, events: tuple[TimedEvent, ...] | None = None
    ) -> None:
        """Use these faults from the next shot on: the previous faults, followed by new ones.

        A new fault that repeats earlier values, such as `stuck`, starts without memory of earlier shots.

        Args:
            model: model with the faults.
            faulty: encoder with the faults.
            events: events of the device, including device faults; None: as before.
        """
        if events is not None:
            self.constants = replace(self.constants, events=events)
            self.use_device(self.device)
        self._model, self._faulty = model, faulty
        held = () if model.faults is None else model.faults.extended(self._state.model.faults)
        wire = None if faulty is None else faulty.extended(self._state.wire)
        self._state = self._state._replace(model=self._state.model._replace(faults=held), wire=wire)

    def shoot(self, most: int, fired: bool = True) -> Block | None:
        """Compute the next shots; return None after the last. Packets do not depend on the block size.

        Args:
            most: maximum number of shots.
            fired: whether the beams fire.
        """
        shot, count = self.next_shot, min(most, self._model.shot_count - self.next_shot)
        if count <= 0:
            return None
        self._before.append((shot, self._state))
        if self._state.shot_policy.is_plain and fired:
            return self._fire(count, None, _NOT_SETTLING)
        count, silent = self._advance(count)
        settled, settling = self._settled(count)
        fires = (
            self._state.shot_policy.fires if fired else np.zeros((1, self._model.beam_count), dtype=np.bool_)
        )
        if settled is not None:
            fires = settled[:, None] if fires is None else fires & settled[:, None]
        return self._fire(count, fires, settling, silent)

    def warm_up(self) -> None:
        """Compute the next shot and discard it, to fill the processor's caches."""
        kept = self.next_shot, self._state, self._before
        self._before = deque()
        self.shoot(1)
        self.next_shot, self._state, self._before = kept

    def skip_to(self, shot: int) -> None:
        """Continue with this shot, without computing the shots before it."""
        while self.next_shot < shot:
            count, silent = self._advance(shot - self.next_shot)
            self._skip(count, silent, self._state.model.scanner)

    def rewind(self, shot: int) -> None:
        """Go back to a shot, to compute it and the following shots again.

        Raises:
            ValueError: the shot's block is no longer kept.
        """
        while self._before and self._before[-1][0] > shot:
            self._before.pop()
        if not self._before:
            raise ValueError(f"shot {shot} is not kept")
        self.next_shot, self._state = self._before[-1]
        if shot > self.next_shot:
            self._catch_up(shot)

    def _advance(self, most: int) -> tuple[int, bool]:
        """Advance the device to the next shot; return how many shots share its state, and whether they are silent."""
        shot, period_ns = self.next_shot, self._model.period_ns
        device = advance(self.constants, self.device, shot * period_ns)
        if device is not self.device:
            self.use_device(device)
        return self._state.shot_policy.steady(shot, most, period_ns)

    def _settled(self, count: int) -> tuple[BoolArray | None, Settling]:
        """(shots,) Whether the beams have settled in each of the next shots, None: in all; and the later state."""
        settling_ns = self.device.settings.settling_ns
        if settling_ns == 0:
            return None, _NOT_SETTLING
        patterns = self._model.patterns(self.next_shot, count, self._state.model.scanner)
        return self._state.settling.settled(patterns, self.next_shot, self._model.period_ns, settling_ns)

    def _fire(self, count: int, fires: BoolArray | None, settling: Settling, silent: bool = False) -> Block:
        state = self._state
        measurement, model, injected = measure(self._model, self.next_shot, count, state.model, fires, silent)
        stamped, status = _stamped(measurement, state), state.shot_policy.status
        if silent:
            status = status._replace(silent=True)
        due_ns, wire, held = measurement.due_ns.tolist(), None, frozenset[int]()
        if self._faulty is None or state.wire is None:
            packets = list(self._encoder.packets(stamped, status))
        else:
            sent, wire = self._faulty.packets(measurement, stamped, status, state.wire)
            packets, due_ns, held, injected = sent.packets, sent.due_ns, sent.held, [*injected, *sent.faults]
        self.next_shot += count
        self._state = _State(model, state.shot_policy, state.unnumbered + silent * count, settling, wire)
        return Block(measurement, packets, due_ns, tuple(injected), silent, held)

    def _catch_up(self, shot: int) -> None:
        if self._model.faults or self._model.compensation or self._faulty or self.device.settings.settling_ns:
            # Their state depends on the measurements of the skipped shots.
            self._before.pop()
            self.shoot(shot - self.next_shot)
            return
        count, silent = self._advance(shot - self.next_shot)
        self._skip(count, silent, self._model.state_after(self.next_shot, count, self._state.model.scanner))

    def _skip(self, count: int, silent: bool, scanner: ScannerState) -> None:
        """Skip `count` shots without measuring them; `scanner` is the scanner's state after them."""
        state = self._state
        model, unnumbered = state.model._replace(scanner=scanner), state.unnumbered + silent * count
        self._state = state._replace(model=model, unnumbered=unnumbered)
        self.next_shot += count


def _stamped(measurement: Measurement, state: _State) -> Measurement:
    clock = state.shot_policy.device.clock
    if state.unnumbered == 0 and (state.shot_policy.is_plain or clock.is_exact):
        return measurement
    # The device reads its clock once a shot, and a timer for its beams: faults of the clock leave their offsets right.
    time_ns = clock._replace(errors=()).reads_ns(measurement.time_ns)
    error_ns = clock.reads_ns(measurement.time_ns[:, :1]) - time_ns[:, :1]
    return replace(
        measurement,
        shot=measurement.shot - state.unnumbered,
        time_ns=time_ns + error_ns,
        due_ns=clock.reads_ns(measurement.due_ns),
    )

"""The emulated device without a clock or a port: measurements and packets, shot by shot."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from lidar_emu.measurement import Measurement
from lidar_emu.shots import Model, ModelState, initial_state, measure
from lidar_emu.wire import Encoder, Packet

if TYPE_CHECKING:
    from lidar_emu.faults.schedule import Injected
    from lidar_emu.faulty_packets import FaultyPackets, WireState


@dataclass(frozen=True)
class Block:
    """Consecutive shots, measured and encoded."""

    measurement: Measurement
    packets: list[Packet]
    """Empty ones were taken away by faults."""
    due_ns: list[int]
    """When packets are due: as the measurement says, but for faults."""
    faults: tuple[Injected, ...] = ()
    """Which faults acted."""

    def part(self, first: int, end: int) -> Block:
        """Some of the shots: rows from `first`, and before `end`."""
        if (first, end) == (0, len(self.packets)):
            return self
        start = int(self.measurement.shot[0])
        return Block(
            self.measurement.part(first, end),
            self.packets[first:end],
            self.due_ns[first:end],
            tuple(fault for fault in self.faults if start + first <= fault.shot < start + end),
        )


class _State(NamedTuple):
    """What is carried from shot to shot."""

    model: ModelState
    wire: WireState | None


class Session:
    """Works through the shots of a model, in order.

    Args:
        model: what is measured.
        encoder: how it goes onto the link.
        kept_blocks: how many blocks back `rewind` can go.
        faulty: what becomes of packets; None: nothing.
    """

    def __init__(
        self, model: Model, encoder: Encoder, kept_blocks: int = 1, faulty: FaultyPackets | None = None
    ) -> None:
        self._model = model
        self._encoder = encoder
        self._faulty = faulty
        self._state = _State(initial_state(model), None if faulty is None else faulty.initial)
        self._before: deque[tuple[int, _State]] = deque(maxlen=kept_blocks)
        self.next_shot = 0
        """The first shot that has not been computed."""

    def shoot(self, most: int, fired: bool = True) -> Block | None:
        """The next shots, at most so many; None after the last. Packets do not depend on how they are grouped.

        Args:
            most: shots.
            fired: whether the beams fire at all.
        """
        count = min(most, self._model.shot_count - self.next_shot)
        if count <= 0:
            return None
        self._before.append((self.next_shot, self._state))
        measurement, model_state, injected = measure(
            self._model, self.next_shot, count, self._state.model, fired
        )
        self.next_shot += count
        if self._faulty is None or self._state.wire is None:
            self._state = _State(model_state, None)
            packets, due_ns = list(self._encoder.packets(measurement)), measurement.due_ns.tolist()
        else:
            packets, due_ns, wire_state, more = self._faulty.packets(measurement, self._state.wire)
            self._state = _State(model_state, wire_state)
            injected = [*injected, *more]
        return Block(measurement, packets, due_ns, tuple(injected))

    def rehearse(self) -> None:
        """Compute the next shot and forget it: what that takes is then at hand in the processor's caches."""
        kept = self.next_shot, self._state, self._before.copy()
        self.shoot(1)
        self.next_shot, self._state, self._before = kept

    def pass_over(self, shot: int) -> None:
        """Go on with this shot; those before it are never computed."""
        self.next_shot = max(shot, self.next_shot)

    def rewind(self, shot: int) -> None:
        """Go back to a shot that is kept, and compute it and those after it again.

        Raises:
            ValueError: the block that it was computed in is not kept any more.
        """
        while self._before and self._before[-1][0] > shot:
            self._before.pop()
        if not self._before:
            raise ValueError(f"shot {shot} is not kept")
        self.next_shot, self._state = self._before[-1]
        if shot > self.next_shot:
            self._catch_up(shot)

    def use_pattern(self, pattern: int) -> None:
        """From the next shot on, use these beams, if there are any of this number."""
        scanner = self._model.commanded(self._state.model.scanner, pattern)
        if scanner is not None:
            self._state = self._state._replace(model=self._state.model._replace(scanner=scanner))

    def use_faults(self, model: Model, faulty: FaultyPackets | None) -> None:
        """From the next shot on, have the faults of these: those that there were, and more after them.

        What repeats something from before it, such as a value that is stuck, knows of no shot before this one.
        """
        self._model, self._faulty = model, faulty
        held = () if model.faults is None else model.faults.resumed(self._state.model.faults)
        wire = None if faulty is None else faulty.resumed(self._state.wire)
        self._state = self._state._replace(model=self._state.model._replace(faults=held), wire=wire)

    def _catch_up(self, shot: int) -> None:
        """From the beginning of the block, which stays kept, to a shot in it."""
        count, scanner = shot - self.next_shot, self._state.model.scanner
        if self._model.faults is not None or self._faulty is not None:
            # What faults carry from shot to shot follows from what is measured.
            self._before.pop()
            self.shoot(count)
            return
        after = self._model.state_after(self.next_shot, count, scanner)
        self.next_shot, self._state = (
            shot,
            self._state._replace(model=self._state.model._replace(scanner=after)),
        )

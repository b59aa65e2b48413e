"""The emulated device without a clock or a port: measurements and packets, shot by shot."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from lidar_emu.measurement import Measurement
from lidar_emu.scanner.model import ScannerState
from lidar_emu.shots import Model
from lidar_emu.wire import Encoder, Packet


@dataclass(frozen=True)
class Block:
    """Consecutive shots, measured and encoded."""

    measurement: Measurement
    packets: list[Packet]

    def part(self, first: int, end: int) -> Block:
        """Some of the shots: rows from `first`, and before `end`."""
        if (first, end) == (0, len(self.packets)):
            return self
        return Block(self.measurement.part(first, end), self.packets[first:end])


class Session:
    """Works through the shots of a model, in order.

    Args:
        model: what is measured.
        encoder: how it goes onto the link.
        kept_blocks: how many blocks back `rewind` can go.
    """

    def __init__(self, model: Model, encoder: Encoder, kept_blocks: int = 1) -> None:
        self._model = model
        self._encoder = encoder
        self._state = model.initial_state
        self._before: deque[tuple[int, ScannerState]] = deque(maxlen=kept_blocks)
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
        measurement, self._state = self._model.measure(self.next_shot, count, self._state)
        if not fired:
            measurement = measurement.unfired()
        self.next_shot += count
        return Block(measurement, list(self._encoder.packets(measurement)))

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
        first, state = self._before[-1]
        self.next_shot = shot
        self._state = self._model.state_after(first, shot - first, state) if shot > first else state

    def use_pattern(self, pattern: int) -> None:
        """From the next shot on, use these beams, if there are any of this number."""
        self._state = self._model.commanded(self._state, pattern) or self._state

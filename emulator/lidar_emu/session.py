"""The emulated device without a clock or a port: measurements and packets, shot by shot."""

from __future__ import annotations

from dataclasses import dataclass

from lidar_emu.measurement import Measurement
from lidar_emu.shots import Model
from lidar_emu.wire import Encoder, Packet


@dataclass(frozen=True)
class Block:
    """Consecutive shots, measured and encoded."""

    measurement: Measurement
    packets: list[Packet]


class Session:
    """Works through the shots of a model, in order.

    Args:
        model: what is measured.
        encoder: how it goes onto the link.
    """

    def __init__(self, model: Model, encoder: Encoder) -> None:
        self._model = model
        self._encoder = encoder
        self._state = model.initial_state
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
        measurement, self._state = self._model.measure(self.next_shot, count, self._state)
        if not fired:
            measurement = measurement.unfired()
        self.next_shot += count
        return Block(measurement, list(self._encoder.packets(measurement)))

    def pass_over(self, shot: int) -> None:
        """Go on with this shot; those before it are never computed."""
        self.next_shot = max(shot, self.next_shot)

"""The emulated device without a clock or a port: measurements and packets, block by block."""

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
    """Works through the shots of a model; what is carried from shot to shot is here.

    Args:
        model: what is measured.
        encoder: how it goes onto the link.
        block_shots: shots computed at a time. Packets do not depend on it.
    """

    def __init__(self, model: Model, encoder: Encoder, block_shots: int) -> None:
        self.model = model
        self._encoder = encoder
        self._block_shots = block_shots
        self._next_shot = 0
        self._state = model.initial_state

    def next_block(self) -> Block | None:
        """The next shots; None after the last."""
        count = min(self._block_shots, self.model.shot_count - self._next_shot)
        if count <= 0:
            return None
        measurement, self._state = self.model.measure(self._next_shot, count, self._state)
        self._next_shot += count
        return Block(measurement, list(self._encoder.packets(measurement)))

"""The emulated device without a clock or a port: measurements and packets, block by block."""

from __future__ import annotations

from dataclasses import dataclass

from lidar_emu.measurement import Measurement
from lidar_emu.shots import Model, measure_in_blocks
from lidar_emu.wire import Encoder, Packet


@dataclass(frozen=True)
class Block:
    """Consecutive shots, measured and encoded."""

    measurement: Measurement
    packets: list[Packet]


class Session:
    """Works through the shots of a model.

    Args:
        model: what is measured.
        encoder: how it goes onto the link.
        block_shots: shots computed at a time. Packets do not depend on it.
    """

    def __init__(self, model: Model, encoder: Encoder, block_shots: int) -> None:
        self._encoder = encoder
        self._measurements = measure_in_blocks(model, block_shots)

    def next_block(self) -> Block | None:
        """The next shots; None after the last."""
        measurement = next(self._measurements, None)
        if measurement is None:
            return None
        return Block(measurement, list(self._encoder.packets(measurement)))

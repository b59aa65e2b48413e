"""A prescribed flight: shots computed ahead of time, as far as the ring holds them."""

from __future__ import annotations

from lidar_emu.runtime.feed import Desk
from lidar_emu.session import Block


class AheadFeed:
    """Computes block after block.

    Args:
        first: the block that has been computed already.
        block_shots: shots of each further one.
        start_ns: instant of the monotonic clock at scenario time 0.
    """

    def __init__(self, desk: Desk, first: Block, block_shots: int, start_ns: int) -> None:
        self._desk = desk
        self._first = first
        self._block_shots = block_shots
        self._start_ns = start_ns

    def fly(self) -> None:
        """See `Feed`."""
        desk = self._desk
        desk.begin(self._start_ns)
        block: Block | None = self._first
        while block is not None and not desk.interrupted():
            for packet in desk.outbox.announce(block):
                if not desk.push(packet):
                    return
            desk.outbox.settle()
            block = desk.session.shoot(self._block_shots)
        desk.finish()

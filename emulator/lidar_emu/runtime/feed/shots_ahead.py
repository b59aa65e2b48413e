"""The shots of a planned flight: those that are computed before the run, and the feed of them all."""

from __future__ import annotations

from lidar_emu.runtime.feed.ahead import AheadFeed
from lidar_emu.runtime.feed.base import Desk, Feed
from lidar_emu.runtime.feed.warm_up import rehearse
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.session import Block, Session
from lidar_emu.shots.model import Model
from lidar_emu.wire import Encoder


class ShotsAhead:
    """Shots in blocks.

    Args:
        session: computes them.
        model: of the session.
        encoder: of the session.
        block_shots: of the longest block.
        pace: of the run.
        known: whether it is known before the run what the first shots will be.
    """

    def __init__(
        self, session: Session, model: Model, encoder: Encoder, block_shots: int, pace: Pace, known: bool
    ) -> None:
        self._session, self._model = session, model
        self._block_shots, self._pace, self._known = block_shots, pace, known
        if not (known and session.device.measures):
            self.first = rehearse(model, encoder)
            """The first block of the flight or, where that is not known, a shot that is like it."""
        if known:
            self.first = self._next()

    def feed(self, desk: Desk, start_ns: int | None) -> Feed:
        """From the first shot on; `start_ns` as of `AheadFeed`."""
        first = self.first if self._known else self._next()
        return AheadFeed(desk, first, self._block_shots, start_ns, self._model.period_ns, self._pace)

    def _next(self) -> Block:
        block = self._session.shoot(self._block_shots)
        assert block is not None
        return block

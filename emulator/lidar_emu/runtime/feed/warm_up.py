"""A shot before the flight: it compiles what will be needed, and shows how long packets are."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

from lidar_emu.session import Block, Session
from lidar_emu.shots.model import Model
from lidar_emu.trajectory.live_datagram import Truth
from lidar_emu.wire import Encoder

_STILL = (0.0, 0.0, 0.0)
_FACING_DOWN = (0.0, 0.5**0.5, 0.5**0.5, 0.0)
_HOVER = Truth(0, 0, (0.0, 0.0, 1000.0), _STILL, _STILL, _FACING_DOWN, _STILL)


def rehearse(model: Model, encoder: Encoder) -> Block:
    """Shot 0; where truth is live as it would be a kilometre above the site's origin, of which nothing stays."""
    with _hovering(model):
        block = Session(model, encoder).shoot(1)
    assert block is not None
    return block


def _hovering(model: Model) -> AbstractContextManager[None]:
    if model.flight is None or not model.flight.is_live:
        return nullcontext()
    from lidar_emu.trajectory.live import LiveTrajectory

    assert isinstance(model.flight.trajectory, LiveTrajectory)
    return model.flight.trajectory.pretending(_HOVER)

"""A shot before the first truth: it compiles what will be needed, and shows how long packets are."""

from __future__ import annotations

from lidar_emu.session import Block, Session
from lidar_emu.shots import FlightModel, Model
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.live_datagram import Truth
from lidar_emu.wire import Encoder

_STILL = (0.0, 0.0, 0.0)
_FACING_DOWN = (0.0, 0.5**0.5, 0.5**0.5, 0.0)
_HOVER = Truth(0, 0, (0.0, 0.0, 1000.0), _STILL, _STILL, _FACING_DOWN, _STILL)


def rehearse(model: Model, encoder: Encoder) -> Block:
    """Shot 0 as it would be a kilometre above the site's origin; the trajectory then knows of nothing again."""
    assert isinstance(model, FlightModel)
    trajectory = model.flight.trajectory
    assert isinstance(trajectory, LiveTrajectory)
    with trajectory.pretending(_HOVER):
        block = Session(model, encoder).shoot(1)
    assert block is not None
    return block

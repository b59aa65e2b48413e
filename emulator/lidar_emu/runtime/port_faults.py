"""What a run has where things are to go wrong; what that needs is imported only there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lidar_emu.runtime.options import RunOptions
from lidar_emu.scenario.schema import Scenario
from lidar_emu.shots.model import Model
from lidar_emu.transports.spec import Kind
from lidar_emu.wire import Encoder

if TYPE_CHECKING:
    from lidar_emu.faults.encoder import FaultyEncoder


def packets_on_order(scenario: Scenario, encoder: Encoder, options: RunOptions) -> FaultyEncoder | None:
    """None where no packets go wrong.

    Raises:
        InputError: a fault is none of this link.
    """
    if not scenario.faults:
        return None
    from lidar_emu.faults.encoder import faulty_encoder

    return faulty_encoder(scenario, encoder, options.port.kind is Kind.CAN)


def port_on_order(scenario: Scenario, model: Model, options: RunOptions) -> list[dict[str, Any]] | None:
    """The faults of the port; None where there are none and none can be ordered.

    Raises:
        InputError: a fault is none of this link, or its time is not that of the clock.
    """
    if not (scenario.faults or options.control):
        return None
    from lidar_emu.runtime.link_faults import link_orders

    end_ns = None if scenario.live else model.shot_count * scenario.timing.period_ns
    orders = link_orders(scenario, end_ns, options.pace, options.port.kind is Kind.CAN)
    return orders if orders or options.control else None

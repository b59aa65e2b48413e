"""The faults of the port that a scenario orders, as the port's process takes them."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from lidar_emu.errors import Finding, InputError
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.scenario import faults as kinds
from lidar_emu.scenario.schema import Scenario
from lidar_emu.transports.faulty_link import PortFault

_ON_A_BUS = (kinds.ErrorFrames, kinds.BusOff)


def link_orders(scenario: Scenario, end_ns: int | None, pace: Pace, can: bool) -> list[dict[str, Any]]:
    """For JSON; empty where the scenario orders none.

    Args:
        scenario: what is flown.
        end_ns: of the run, in scenario time; None: nobody knows.
        pace: of the run.
        can: whether the link is a CAN bus.

    Raises:
        InputError: a fault is none of this link, or its time is not that of the clock.
    """
    return [
        link_order(scenario, number, fault, end_ns, pace, can)
        for number, fault in enumerate(scenario.faults)
        if isinstance(fault, kinds.LinkFault)
    ]


def link_order(
    scenario: Scenario, number: int, fault: kinds.LinkFault, end_ns: int | None, pace: Pace, can: bool
) -> dict[str, Any]:
    """One of them; arguments and errors as of `link_orders`."""
    where = f"faults.{number}.kind"
    if pace is not Pace.WALL:
        found = Finding(f"{fault.kind} at pace {pace}")
        raise InputError(scenario.name, where, found, "allowed: --pace wall, by whose clock ports go wrong")
    if isinstance(fault, _ON_A_BUS) and not can:
        found = Finding(f"{fault.kind} on a byte link")
        raise InputError(scenario.name, where, found, "allowed: on a CAN bus")
    order = PortFault(
        number,
        fault.kind,
        round(fault.from_s * 1e9),
        end_ns if fault.to_s is None else round(fault.to_s * 1e9),
        scenario.seed,
        _rate(fault),
        fault.buffer_bytes if isinstance(fault, kinds.SlowLine) else 0,
    )
    return asdict(order)


def _rate(fault: kinds.LinkFault) -> float:
    match fault:
        case kinds.SlowLine():
            return float(fault.bit_rate)
        case kinds.Babble():
            return float(fault.bytes_per_s)
        case kinds.ErrorFrames():
            return fault.rate_hz
    return 0.0

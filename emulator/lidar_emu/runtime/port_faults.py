"""Faults of the port, passed from the scenario to the port process."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from lidar_emu.errors import Finding, InputError
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.scenario.faults import link as kinds
from lidar_emu.scenario.schema import Scenario

_CAN_ONLY = (kinds.ErrorFrames, kinds.BusOff)


def port_faults(scenario: Scenario, end_ns: int | None, pace: Pace, can: bool) -> list[dict[str, Any]]:
    """The faults of the port, each a `PortFault` as a mapping for JSON; empty if the scenario has none.

    Args:
        scenario: scenario of the run.
        end_ns: end of the run, in scenario time; None: unknown.
        pace: pace of the run.
        can: whether the link is a CAN bus.

    Raises:
        InputError: a fault cannot happen on this link, or the pace is not `Pace.WALL`.
    """
    return [
        port_fault(scenario, number, fault, end_ns, pace, can)
        for number, fault in enumerate(scenario.faults)
        if isinstance(fault, kinds.LinkFault)
    ]


def port_fault(
    scenario: Scenario, number: int, fault: kinds.LinkFault, end_ns: int | None, pace: Pace, can: bool
) -> dict[str, Any]:
    """Fault `number` of the scenario; arguments and errors as for `port_faults`."""
    from lidar_emu.transports.faulty_link import PortFault

    where = f"faults.{number}.kind"
    if pace is not Pace.WALL:
        found = Finding(f"{fault.kind} at pace {pace}")
        raise InputError(scenario.name, where, found, "use --pace wall: port faults follow the wall clock")
    if isinstance(fault, _CAN_ONLY) and not can:
        found = Finding(f"{fault.kind} on a byte link")
        raise InputError(scenario.name, where, found, "use a CAN bus")
    return asdict(
        PortFault(
            number,
            fault.kind,
            round(fault.from_s * 1e9),
            end_ns if fault.to_s is None else round(fault.to_s * 1e9),
            scenario.seed,
            _rate(fault),
        )
    )


def _rate(fault: kinds.LinkFault) -> float:
    match fault:
        case kinds.SlowLine():
            return float(fault.bit_rate)
        case kinds.Babble():
            return float(fault.bytes_per_s)
        case kinds.ErrorFrames():
            return fault.rate_hz
    return 0.0

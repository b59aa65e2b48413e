"""Injected faults: what fails, when, how often and in which beams."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lidar_emu.scenario.faults.beams import BeamFault, LightFault, ReceiverFault
from lidar_emu.scenario.faults.packets import ContentFault, DeviceFault, LinkFault, PacketFault

__all__ = [
    "BeamFault", "ContentFault", "DeviceFault", "Fault", "LightFault", "LinkFault", "PacketFault", "ReceiverFault",
    "ScheduledFault",
]  # fmt: skip

ScheduledFault = LightFault | ReceiverFault | BeamFault | ContentFault | PacketFault | DeviceFault
"""Faults scheduled by shots; faults of the link are scheduled by the clock of the port."""

Fault = Annotated[ScheduledFault | LinkFault, Field(discriminator="kind")]

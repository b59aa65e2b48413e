"""Injected faults: what fails, when, how often and in which beams."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lidar_emu.scenario.faults.beams import (
    BeamFault,
    Bias,
    Drift,
    Dropout,
    FalseInvalid,
    FalseValid,
    Frozen,
    Interval,
    Noise,
    Outlier,
    Scale,
    Stuck,
    SwappedBeams,
    WrongSign,
)
from lidar_emu.scenario.faults.device import BrownOut, DeviceFault, Interlock
from lidar_emu.scenario.faults.link import Babble, BusOff, Disconnect, ErrorFrames, LinkFault, SlowLine
from lidar_emu.scenario.faults.packets import (
    BitErrors,
    ContentFault,
    Delayed,
    Doubled,
    FrozenCounter,
    Garbage,
    Lost,
    OtherUnit,
    OtherVersion,
    PacketFault,
    Reordered,
    Silence,
    StalePacket,
    TimeJump,
    Truncated,
    WrongCrc,
    WrongEndian,
    WrongUnit,
)
from lidar_emu.scenario.faults.physics import (
    Alias,
    Clutter,
    FalseAlarms,
    LaserFade,
    LightFault,
    Misalignment,
    MissingSegment,
    ReceiverFault,
    ReflectancePatch,
    WrongBranch,
)

__all__ = [
    "Alias", "Babble", "BeamFault", "Bias", "BitErrors", "BrownOut", "BusOff", "Clutter", "ContentFault", "Delayed",
    "DeviceFault", "Disconnect", "Doubled", "Drift", "Dropout", "ErrorFrames", "FalseAlarms", "FalseInvalid",
    "FalseValid", "Fault", "Frozen", "FrozenCounter", "Garbage", "Interlock", "Interval", "LaserFade", "LightFault",
    "LinkFault", "Lost", "Misalignment", "MissingSegment", "Noise", "OtherUnit", "OtherVersion", "Outlier",
    "PacketFault", "ReceiverFault", "ReflectancePatch", "Reordered", "Scale", "ScheduledFault", "Silence",
    "SlowLine", "StalePacket", "Stuck", "SwappedBeams", "TimeJump", "Truncated", "WrongBranch", "WrongCrc",
    "WrongEndian", "WrongSign", "WrongUnit",
]  # fmt: skip

ScheduledFault = LightFault | ReceiverFault | BeamFault | ContentFault | PacketFault | DeviceFault
"""Faults scheduled by shots; faults of the link are scheduled by the clock of the port."""

Fault = Annotated[ScheduledFault | LinkFault, Field(discriminator="kind")]

"""Wire protocol of the lidar: encode shots to bytes or CAN frames, and decode them, without input or output (sans-IO).

Standard library only. `Device` and `CommandReader` are for the instrument; `Host`, `SerialReceiver` and `CanReceiver`
are for the flight computer. An `Interface` is read from a TOML definition, of which two are part of the package.
INTERFACE.md in this folder documents the default one.
"""

from lidar_protocol.can_frames import CanFrame
from lidar_protocol.commands import CanCommandReader, CommandReader
from lidar_protocol.definition_file import SHIPPED, default_interface, load, load_file, shipped_interface
from lidar_protocol.definitions import CanSet, Interface
from lidar_protocol.device import Device
from lidar_protocol.errors import DecodeError, DefinitionError, EncodeError
from lidar_protocol.host import CanReceiver, Host, SerialReceiver
from lidar_protocol.packet import (
    Acknowledge,
    BadCommand,
    Command,
    HostMessage,
    Housekeeping,
    Message,
    Received,
)

__all__ = [
    "SHIPPED",
    "Acknowledge",
    "BadCommand",
    "CanCommandReader",
    "CanFrame",
    "CanReceiver",
    "CanSet",
    "Command",
    "CommandReader",
    "DecodeError",
    "DefinitionError",
    "Device",
    "EncodeError",
    "Host",
    "HostMessage",
    "Housekeeping",
    "Interface",
    "Message",
    "Received",
    "SerialReceiver",
    "default_interface",
    "load",
    "load_file",
    "shipped_interface",
]

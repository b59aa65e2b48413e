"""The lidar's wire protocol: shots to bytes or CAN frames and back, without any input or output of its own.

Standard library only. `Device` and `CommandReader` are the instrument's side; `Host`, `SerialReceiver` and
`CanReceiver` are the flight computer's. An `Interface` is what they agree upon: a TOML file, of which two come with
the package. INTERFACE.md beside this file says the default one in words.
"""

from lidar_protocol.can_frames import CanFrame
from lidar_protocol.can_host import CanReceiver
from lidar_protocol.commands import CanCommandReader, CommandReader
from lidar_protocol.definitions import CanSet, Interface
from lidar_protocol.device import Device
from lidar_protocol.errors import DecodeError, DefinitionError, EncodeError
from lidar_protocol.host import Host, SerialReceiver
from lidar_protocol.message import Acknowledge, BadCommand, Command, Housekeeping, Message, Received
from lidar_protocol.reading import SHIPPED, default_interface, load, load_file, shipped_interface

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

"""The lidar's wire protocol: shots to bytes or CAN frames and back, without any input or output of its own.

Standard library only. `Device` is the instrument's side, `SerialReceiver` and `CanReceiver` are the flight
computer's; `default_interface` is what they agree upon, and INTERFACE.md beside this file says it in words.
"""

from lidar_protocol.can_frames import CanFrame
from lidar_protocol.definitions import CanSet, Interface, default_interface
from lidar_protocol.device import Device
from lidar_protocol.errors import DecodeError, DefinitionError, EncodeError
from lidar_protocol.host import CanReceiver, SerialReceiver
from lidar_protocol.message import Message

__all__ = [
    "CanFrame",
    "CanReceiver",
    "CanSet",
    "DecodeError",
    "DefinitionError",
    "Device",
    "EncodeError",
    "Interface",
    "Message",
    "SerialReceiver",
    "default_interface",
]

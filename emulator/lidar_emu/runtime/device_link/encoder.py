"""How the device says what is no shot: acknowledgements and housekeeping, on bytes or on CAN."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lidar_emu.runtime.feed.packet_queue import payload_of
from lidar_protocol import Device, Interface
from lidar_protocol.layout import Layout


def housekeeping_layouts(interface: Interface, can: bool) -> list[Layout]:
    """In what a device can say how it is; empty: it cannot."""
    if can:
        blocks = interface.can.housekeeping if interface.can else ()
        return [block.layout for block in blocks]
    return [] if interface.housekeeping is None else [interface.housekeeping]


class DownlinkEncoder:
    """What one unit can say on one kind of link.

    Args:
        interface: by which it talks.
        unit: of the device.
        can: whether the link is a CAN bus.
        say: sends at once.
    """

    def __init__(self, interface: Interface, unit: int, can: bool, say: Callable[[bytes], None]) -> None:
        self.interface, self.unit, self.can = interface, unit, can
        self.say = say
        self._device = Device(interface, unit)

    @property
    def has_commands(self) -> bool:
        """Whether a host can command the device."""
        commands = self.interface.commands
        return commands is not None and (not self.can or all(each.can for each in commands.commands))

    def acknowledgement(self, number: int, command: int | str, values: Mapping[str, Any]) -> bytes | None:
        """The answer to a command; None where the interface has none.

        Args:
            number: how many answers went before.
            command: its name or code.
            values: `sequence`, `verdict` and the like.

        Raises:
            EncodeError: a value cannot be sent.
        """
        if self.can:
            can = self.interface.can
            if can is None or can.acknowledge is None:
                return None
            return payload_of([self._device.acknowledge_frame(command, **values)])
        if self.interface.acknowledge is None:
            return None
        return self._device.acknowledge(number, command, **values)

    def housekeeping(self, number: int, values: Mapping[str, Any]) -> bytes:
        """How the device is.

        Args:
            number: how many went before.
            values: by the names of the fields.

        Raises:
            EncodeError: a value is missing or cannot be sent.
        """
        if self.can:
            return payload_of(self._device.housekeeping_frames(values))
        return self._device.housekeeping(number, values)

"""The device's side of the link besides its shots: what it hears, and what it tells of itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from lidar_emu.device.timeline import DeviceTimeline
from lidar_emu.runtime.change_queue import Changes
from lidar_emu.runtime.device_link.command_handler import CommandHandler
from lidar_emu.runtime.device_link.encoder import DownlinkEncoder, housekeeping_layouts
from lidar_emu.runtime.device_link.housekeeping import HousekeepingSender
from lidar_emu.runtime.device_link.received_command import ReceivedCommand
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.summary import Tally


class Front(NamedTuple):
    """Each of them where the interface provides for it on this link."""

    commands: CommandHandler | None
    housekeeper: HousekeepingSender | None

    def to_json(self) -> dict[str, Any]:
        """What was heard and told, under the names of the summary file."""
        told = self.housekeeper
        return {
            "commands": None if self.commands is None else self.commands.to_json(),
            "housekeeping": None
            if told is None
            else {"sent": told.sent, "encode_failures": told.encode_failures},
        }


def open_device_link(
    voice: DownlinkEncoder,
    device: DeviceTimeline,
    can_date: Callable[[int], bool],
    tally: Tally,
    changes: Changes,
    observers: Sequence[Observer],
) -> Front:
    """The front of a run.

    Args:
        voice: by which the device talks.
        device: that is commanded and told of.
        can_date: see `CommandHandler`.
        tally: counts shots.
        changes: where shots find what they are to follow.
        observers: told of commands, answers and housekeeping.

    Raises:
        InputError: the interface's acknowledgement or housekeeping cannot be filled.
    """

    def commanded(heard: ReceivedCommand, shot: int | None) -> None:
        for observer in observers:
            observer.on_command(heard, shot)

    def answered(payload: bytes, time_ns: int) -> None:
        for observer in observers:
            observer.on_acknowledgement(payload, time_ns)

    def kept_house(payload: bytes, time_ns: int) -> None:
        for observer in observers:
            observer.on_housekeeping(payload, time_ns)

    commands = None
    if voice.has_commands:
        commands = CommandHandler(voice, device, can_date, changes, commanded, answered)
    if not housekeeping_layouts(voice.interface, voice.can):
        return Front(commands, None)
    return Front(commands, HousekeepingSender(voice, device, tally, commands, kept_house))

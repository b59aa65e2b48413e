"""The device's side of the link besides its shots: what it hears, and what it tells of itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from lidar_emu.device.now import DeviceNow
from lidar_emu.runtime.change_queue import Changes
from lidar_emu.runtime.device_link.command_handler import CommandPost
from lidar_emu.runtime.device_link.encoder import Voice, housekeeping_layouts
from lidar_emu.runtime.device_link.housekeeping import Housekeeper
from lidar_emu.runtime.device_link.received_command import Heard
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.summary import Tally


class Front(NamedTuple):
    """Each of them where the interface provides for it on this link."""

    commands: CommandPost | None
    housekeeper: Housekeeper | None

    def to_json(self) -> dict[str, Any]:
        """What was heard and told, under the names of the summary file."""
        told = self.housekeeper
        return {
            "commands": None if self.commands is None else self.commands.to_json(),
            "housekeeping": None if told is None else {"sent": told.sent, "unsayable": told.unsayable},
        }


def open_front(
    voice: Voice,
    device: DeviceNow,
    can_date: Callable[[int], bool],
    tally: Tally,
    changes: Changes,
    observers: Sequence[Observer],
) -> Front:
    """The front of a run.

    Args:
        voice: by which the device talks.
        device: that is commanded and told of.
        can_date: see `CommandPost`.
        tally: counts shots.
        changes: where shots find what they are to follow.
        observers: told of commands, answers and housekeeping.

    Raises:
        InputError: the interface's acknowledgement or housekeeping cannot be filled.
    """

    def commanded(heard: Heard, shot: int | None) -> None:
        for observer in observers:
            observer.commanded(heard, shot)

    def answered(payload: bytes, time_ns: int) -> None:
        for observer in observers:
            observer.answered(payload, time_ns)

    def kept_house(payload: bytes, time_ns: int) -> None:
        for observer in observers:
            observer.kept_house(payload, time_ns)

    commands = None
    if voice.has_commands:
        commands = CommandPost(voice, device, can_date, changes, commanded, answered)
    if not housekeeping_layouts(voice.interface, voice.can):
        return Front(commands, None)
    return Front(commands, Housekeeper(voice, device, tally, commands, kept_house))

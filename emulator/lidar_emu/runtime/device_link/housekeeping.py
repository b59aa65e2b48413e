"""Housekeeping: how the device is, sent at a rate of its own between the shots."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from lidar_emu import __version__
from lidar_emu.device.state import Mode
from lidar_emu.device.timeline import DeviceTimeline
from lidar_emu.errors import InputError
from lidar_emu.runtime.device_link.command_handler import CommandHandler
from lidar_emu.runtime.device_link.encoder import DownlinkEncoder, housekeeping_layouts
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import Outgoing, Report
from lidar_emu.runtime.summary import Tally
from lidar_protocol import EncodeError

_SILENT_COUNTS = {"commands_accepted": 0, "commands_rejected": 0, "bad_bytes": 0}


class HousekeepingSender(Observer):
    """Composes housekeeping and sends it as the shots pass by: at every pace, and as the device is at that time.

    Args:
        voice: by which it is said, and the interface of which has housekeeping.
        device: that is told of.
        tally: counts shots.
        commands: counts commands; None where the device hears none.
        tell: told of what was sent, and of the scenario time that it is about.

    Raises:
        InputError: the interface has fields that cannot be filled.
    """

    def __init__(
        self,
        voice: DownlinkEncoder,
        device: DeviceTimeline,
        tally: Tally,
        commands: CommandHandler | None,
        tell: Callable[[bytes, int], None],
    ) -> None:
        self._voice = voice
        self._device, self._tally, self._commands = device, tally, commands
        self._tell = tell
        self._told: tuple[int, int] | None = None
        self._truth_age_s: float | None = None
        self.sent = 0
        """How many times the device has told how it is."""
        self.encode_failures = 0
        """How many times it could not, for want of a word or of room in a field."""
        try:
            voice.housekeeping(0, self.values(0) | {"mode": self._word(Mode.TRACK)})
        except EncodeError as error:
            raise InputError(
                "wire.interface", "housekeeping", str(error), "allowed: fields of the default interface"
            ) from None

    def on_report(self, packet: Outgoing, report: Report) -> None:  # noqa: ARG002
        """Send what is due by the time of this packet."""
        self.tick(packet.due_ns)

    def on_truth_used(self, shot: int, age_ns: int, truth_time_ns: int) -> None:  # noqa: ARG002
        """Remember how old the truth of the last shot was."""
        self._truth_age_s = age_ns * 1e-9

    def tick(self, time_ns: int) -> None:
        """Send what is due by this scenario time; of several missed instants the last one."""
        state = self._device.at(time_ns)
        rate_hz = state.settings.housekeeping_rate_hz
        if rate_hz == 0 or not state.answers:
            self._told = None
            return
        # The period that the instant is in, by its length and number: another rate counts at once.
        period_ns = round(1e9 / rate_hz)
        period = period_ns, time_ns // period_ns
        if period != self._told:
            self._told = period
            self._send(time_ns)

    def start_flight(self) -> None:
        """Scenario time begins anew."""
        self._told = None

    def _send(self, time_ns: int) -> None:
        payload = self.composed(time_ns)
        if not payload:
            self.encode_failures += 1
            return
        self.sent += 1
        self._voice.say(payload)
        self._tell(payload, time_ns)

    def composed(self, time_ns: int, **instead: Any) -> bytes:
        """How the device is at a scenario time, but for these values; empty where the interface has no room for it."""
        try:
            return self._voice.housekeeping(self.sent, self.values(time_ns) | instead)
        except EncodeError:
            return b""

    def values(self, time_ns: int) -> dict[str, Any]:
        """How the device is at a scenario time, by the names of the fields."""
        state = self._device.at(time_ns)
        shown_ns = state.clock.reads_ns(time_ns)
        major, minor, patch = (int(part) for part in __version__.split(".")[:3])
        return {
            "time_ns": shown_ns,
            "time_s": shown_ns * 1e-9,
            "software_major": major,
            "software_minor": minor,
            "software_patch": patch,
            "mode": self._word(state.mode),
            "interlock_closed": state.interlock_closed,
            "laser_on": state.measures,
            "clock_locked": state.clock_locked,
            "temperature_c": state.heat.temperature_c(self._device.rules.heating, time_ns),
            "laser_power_w": self._device.rules.laser_power_w if state.measures else 0.0,
            "uptime_s": max(0, time_ns - state.restarted_ns) // 10**9,
            "shots_dropped": self._tally.dropped,
            "shots_late": self._tally.late,
            "truth_age_s": self._truth_age_s,
            **(_SILENT_COUNTS if self._commands is None else self._commands.counts),
        }

    def _word(self, mode: Mode) -> str:
        """The mode, or where the interface has no such word the nearest that it has."""
        known = self._voice.interface.enumerations.get(self._enumeration or "", {})
        nearest = (mode, Mode.TRACK if mode is Mode.ACQUIRE else Mode.STANDBY)
        return next((word for word in nearest if word in known), mode)

    @cached_property
    def _enumeration(self) -> str | None:
        layouts = housekeeping_layouts(self._voice.interface, self._voice.can)
        fields = (placed.field for layout in layouts for placed in layout.placed)
        return next((field.enumeration for field in fields if field.name == "mode"), None)

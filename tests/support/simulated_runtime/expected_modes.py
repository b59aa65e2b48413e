"""The modes that a device must have, by the page on the device: a second, plain model of its transitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

_MEASURING = ("acquire", "track")
_INTERLOCKED = ("self_test", "standby", *_MEASURING)


class ExpectedDevice:
    """The device of a scenario, moved on by time, commands and the events of faults. Times are scenario times.

    Args:
        device: `device` of the scenario.
        waited_ns: time from power-up to scenario time 0; None: the flight does not wait for a command.
        events: what happens to the power and the interlock, and when.
    """

    def __init__(
        self, device: Any, rate_hz: float, waited_ns: int | None, events: Sequence[tuple[int, str]]
    ) -> None:
        self._events = sorted(events)
        self.restarts = 0
        start_ns = -(waited_ns or 0)
        start = "standby" if waited_ns is not None and device.start == "track" else device.start
        self._device, self._rate_hz = device, rate_hz
        self.mode, self._pending = "off", list[tuple[int, str]]()
        self._interlock_closed = True
        self.divisor, self.beams = 1, 0b1111
        self._acquisition_ns = round(device.acquisition_s * 1e9)
        # A command may come before scenario time 0, as soon as the port is open.
        self.now_ns = start_ns if waited_ns is not None else -(10**15)
        if start == "boot":
            self._boot(start_ns, cold=True)
        else:
            self._enter(start)
        self.restarts = 0

    def advance(self, to_ns: int) -> None:
        """Let time pass."""
        events = self._events
        while True:
            due = [self._pending[0][0]] if self._pending else []
            due += [events[0][0]] if events else []
            if not due or min(due) > to_ns:
                break
            self.now_ns = min(due)
            if events and events[0][0] == self.now_ns:
                self._happen(events.pop(0)[1])
            else:
                mode = self._pending.pop(0)[1]
                self._enter(mode, self._pending)
        self.now_ns = max(self.now_ns, to_ns)

    def command(self, name: str, values: Mapping[str, Any]) -> None:
        """An accepted command, now."""
        match name:
            case "set_mode" if values["mode"] in _MEASURING:
                if self.mode != "acquire" and values["mode"] != self.mode:
                    self._enter("acquire", [(self.now_ns + self._acquisition_ns, "track")])
            case "set_mode" if values["mode"] != self.mode:
                until_ns = self.now_ns + round(self._device.self_test_s * 1e9)
                self._enter(values["mode"], [(until_ns, "standby")] if values["mode"] == "self_test" else [])
            case "set_rate_hz":
                self.divisor = round(self._rate_hz / values["rate_hz"])
            case "enable_beams":
                self.beams = values["beams"]
            case "set_parameter" if values["parameter"] == 2:
                self._acquisition_ns = round(values["number"] * 1e9)
            case "reset":
                self._boot(self.now_ns, cold=values["restart"] == "cold")

    @property
    def measures(self) -> bool:
        """Whether the laser is on."""
        return self.mode in _MEASURING

    def _boot(self, at_ns: int, cold: bool) -> None:
        device, ends_ns = self._device, at_ns + round(self._device.warm_restart_s * 1e9)
        pending = []
        if cold:
            self.divisor, self.beams, self._acquisition_ns = 1, 0b1111, round(device.acquisition_s * 1e9)
            tested_ns = at_ns + round(device.boot_s * 1e9)
            pending, ends_ns = [(tested_ns, "self_test")], tested_ns + round(device.self_test_s * 1e9)
        if device.after_boot == "standby":
            pending.append((ends_ns, "standby"))
        else:
            pending += [(ends_ns, "acquire"), (ends_ns + self._acquisition_ns, "track")]
        self.restarts += 1
        self._enter("boot", pending)

    def _happen(self, what: str) -> None:
        match what:
            case "interlock_opens":
                self._interlock_closed = False
                self._enter(self.mode, self._pending)
            case "interlock_closes":
                self._interlock_closed = True
            case "power_off":
                self._enter("off")
            case "power_on" if self.mode == "off":
                self._boot(self.now_ns, cold=True)

    def _enter(self, mode: str, pending: list[tuple[int, str]] | None = None) -> None:
        fails = mode in _INTERLOCKED and not self._interlock_closed
        self.mode, self._pending = ("fault", []) if fails else (mode, list(pending or ()))


def events_of_faults(faults: Sequence[Any]) -> list[tuple[int, str]]:
    """What device faults do to the power and the interlock, and when."""
    effects = {"interlock": ("interlock_opens", "interlock_closes"), "brown_out": ("power_off", "power_on")}
    return [
        (round(at_s * 1e9), what)
        for fault in faults
        if fault.kind in effects
        for at_s, what in zip((fault.from_s, fault.to_s), effects[fault.kind], strict=True)
        if at_s is not None
    ]

"""What a host must know of the device's behaviour: modes, times, commands, restarts, and names in Wireshark."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from textwrap import fill
from typing import NamedTuple

from lidar_icd.markdown import table
from lidar_icd.wireshark import identifier
from lidar_protocol.definitions import Interface


class DocumentedDevice(NamedTuple):
    """Behaviour of the device of a scenario."""

    scenario: str
    """Name of the scenario."""
    start: str
    """State at power-up: track, standby or boot."""
    after_boot: str
    """What follows boot and self-test: standby or track."""
    boot_s: float
    self_test_s: float
    warm_restart_s: float
    acquisition_s: float
    rate_hz: float
    settling_s: float
    housekeeping_rate_hz: float
    polled: bool
    """Whether the device sends nothing unasked."""
    pulse_line: str | None
    """Line of the port with the synchronisation pulse; None: there is none."""
    pulse_out: str | None
    """Line of the port with a pulse for each shot; None: there is none."""
    lock_s: float
    """When the clock locks after the start."""
    holdover_s: float | None
    """When the lock of the clock is lost after the start or a synchronisation; None: never."""
    arguments: Mapping[str, str]
    """What this device follows, for each command that not every argument in the fields' ranges suits."""
    modes_of_commands: Mapping[str, Sequence[str]]
    """Modes in which each command is followed."""
    modes_before: Mapping[str, Sequence[str]]
    """For each mode that can be commanded, the modes from which the device changes to it."""


def device_text(interface: Interface, device: DocumentedDevice) -> str:
    """Markdown of the section."""
    known = interface.commands.by_name if interface.commands else {}
    sections = [
        f"Values of `{device.scenario}`. Another scenario states its own: keys `start`, `after_boot`, `boot_s`,\n"
        "`self_test_s`, `warm_restart_s`, `acquisition_s`, `settling_s`, `housekeeping_rate_hz` and `clock` of its\n"
        "part `device`. `lidar-emu icd my.yaml` writes this document anew.",
        _modes(device),
        f"### Commands and modes\n\n{_commands(device, known)}",
    ]
    if "set_mode" in known:
        rows = ((f"`{mode}`", ", ".join(before)) for mode, before in device.modes_before.items())
        targets = table(("`set_mode` to", "from"), rows)
        sections.append(
            f"{targets}\n\nThe mode that the device has is accepted, without effect. `track` is reached by way of "
            "`acquire`.\nWhile the interlock is open `safe` is not left."
        )
    sections += [f"### Times\n\n{_times(device, known)}", f"### Names in Wireshark\n\n{_names(interface)}"]
    return "\n\n".join(sections)


def _modes(device: DocumentedDevice) -> str:
    first = {
        "track": "The device is in `track` from the start.",
        "standby": "The device is in `standby` from the start.",
        "boot": "The device boots at the start.",
    }[device.start]
    then = "standby" if device.after_boot == "standby" else "acquire"
    measures = "measurements, acknowledgements, housekeeping"
    answers = "acknowledgements, housekeeping"
    boot = f"{device.boot_s:g} s, then `self_test`; after a warm restart {device.warm_restart_s:g} s, then `{then}`"
    rows = (
        ("`off`", "while the power fails", "nothing", "nothing"),
        ("boot", boot, "nothing", "nothing"),
        ("`self_test`", f"{device.self_test_s:g} s, then `{then}`", "commands", answers),
        ("`standby`", "until commanded", "commands", answers),
        ("`acquire`", f"{device.acquisition_s:g} s, then `track`", "commands", measures),
        ("`track`", "until commanded", "commands", measures),
        ("`fault`", "from an open interlock until a reset once it is closed", "commands", answers),
        ("`safe`", "until commanded or reset", "commands", answers),
    )
    if device.polled:
        first += (
            " It sends nothing unasked: each accepted `no_op` is answered with\nthe acknowledgement, housekeeping "
            "if it is due, and the last measurement unless that was sent already."
        )
    return f"### Modes\n\n{first}\n\n{table(('mode', 'lasts', 'receives', 'sends'), rows)}"


def _commands(device: DocumentedDevice, known: Iterable[str]) -> str:
    rows = (
        (
            f"`{name}`",
            ", ".join(device.modes_of_commands.get(name, ())) or "none: `out_of_state`",
            device.arguments.get(name, ""),
        )
        for name in known
    )
    commands = table(("command", "is followed in", "arguments that this device can follow"), rows)
    return f"{commands}\n\nOthers are `out_of_range` (the second row of that verdict in section 6)."


def _times(device: DocumentedDevice, known: Iterable[str]) -> str:
    texts = {
        "Answer": "the acknowledgement leaves between two shots, within some tens of milliseconds. No limit is "
        "guaranteed: wait for a second, then repeat. It states the time of the command, not of its transmission.",
        "Repetition": "repeat with the same number. If the first one was received, the verdict is `bad_sequence`, and "
        "nothing is done twice.",
        "Effect": "with the first shot that begins some 3 ms or more after the command was received.",
        "Shots": f"{device.rate_hz:g} a second at the start. A lower rate fires every n-th of them.",
        "Housekeeping": _housekeeping(device.housekeeping_rate_hz),
    }
    if device.pulse_out is not None:
        line = device.pulse_out.upper()
        texts["Pulse"] = (
            f"{line} rises at the `time_ns` of each measured shot, and falls half a period later."
        )
    if "set_pattern" in known:
        texts["Settling"] = (
            f"in shots that begin within {device.settling_s:g} s after a change of pattern, commanded or by itself, no "
            "beam fires: `fired` is 0, the pattern is the new one."
        )
    if "reset" in known:
        texts["Restart"] = (
            "shot numbers begin at 0, the uptime too, and the next command may have any number; a number or an uptime "
            "below the last one shows it. Counters of housekeeping and the sequence counts of acknowledgements and "
            "housekeeping go on. After a cold restart the clock is as at the start."
        )
    if "time_at_tone" in known:
        texts["`time_at_tone`"] = _tone(device.pulse_line)
        cleared = (
            "never cleared"
            if device.holdover_s is None
            else f"cleared {device.holdover_s:g} s after the start or the last synchronisation"
        )
        texts["`clock_locked`"] = f"set {device.lock_s:g} s after power-up, {cleared}."
    return "\n".join(
        fill(f"* **{name}**: {text}", 118, subsequent_indent="  ", break_on_hyphens=False)
        for name, text in texts.items()
    )


def _tone(pulse_line: str | None) -> str:
    if pulse_line is None:
        return "there is no pulse; the time applies to the command's arrival."
    line = pulse_line if pulse_line.startswith("/") else f"{pulse_line.upper()}, high for 1 ms at least"
    return f"the pulse is a rising edge of {line}; before the first one the time applies to the command's arrival."


def _housekeeping(rate_hz: float) -> str:
    often = f"{rate_hz:g} a second" if rate_hz else "none at the start"
    return (
        f"{often}; the first shot whose packet is due at or after a multiple of the period, from the start on, brings "
        "it. A new rate brings one at once; 0: none."
    )


def _names(interface: Interface) -> str:
    name, block, layout = identifier(interface), "beam", interface.packet.beam
    if layout is None:
        block, layout = "shot", interface.packet.header
    on_can = f"; on CAN `{name}_can.MESSAGE.NAME`" if interface.can else ""
    example = f"`{name}.{block}.{layout.placed[0].field.key}`"
    return f"With `lidar.lua` fields are named `{name}.BLOCK.NAME`, such as {example}{on_can}."

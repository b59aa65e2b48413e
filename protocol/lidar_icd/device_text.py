"""What a host must know of the device's behaviour: modes, times, commands, restarts, and names in Wireshark."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from textwrap import fill
from typing import NamedTuple

from lidar_icd.wireshark import identifier
from lidar_protocol.definitions import Interface


class DeviceBehaviour(NamedTuple):
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
    settling_s: float
    housekeeping_rate_hz: float
    polled: bool
    """Whether the device sends nothing unasked."""
    pulse_line: str | None
    """Line of the port with the synchronisation pulse; None: there is none."""
    modes_of_commands: Mapping[str, Sequence[str]]
    """Modes in which each command is followed."""
    modes_before: Mapping[str, Sequence[str]]
    """For each mode that can be commanded, the modes from which the device changes to it."""


def device_text(interface: Interface, device: DeviceBehaviour) -> str:
    """Markdown of the section."""
    known = interface.commands.by_name if interface.commands else {}
    sections = [
        f"Values of `{device.scenario}`; another scenario states its own under `device`, and `lidar-emu icd my.yaml`\n"
        "writes this document anew.",
        _modes(device),
        f"### Commands and modes\n\n{_commands(device, known)}",
    ]
    if "set_mode" in known:
        rows = ((f"`{mode}`", ", ".join(before)) for mode, before in device.modes_before.items())
        table = _table(("`set_mode` to", "from"), rows)
        sections.append(
            f"{table}\n\nThe mode that the device has is accepted, without effect. `track` is reached by way of "
            "`acquire`.\nWhile the interlock is open `safe` is not left."
        )
    sections += [f"### Times\n\n{_times(device, known)}", f"### Names in Wireshark\n\n{_names(interface)}"]
    return "\n\n".join(sections)


def _modes(device: DeviceBehaviour) -> str:
    first = {
        "track": "The device is in `track` from the start.",
        "standby": "The device is in `standby` from the start.",
        "boot": "The device boots at the start.",
    }[device.start]
    then = "standby" if device.after_boot == "standby" else "acquire"
    measures = "measurements, acknowledgements, housekeeping"
    answers = "acknowledgements, housekeeping"
    rows = (
        (
            "boot",
            f"{device.boot_s:g} s; {device.warm_restart_s:g} s after a warm restart",
            "nothing is received",
            "nothing",
        ),
        (
            "`self_test`",
            f"{device.self_test_s:g} s, then `{then}`; not after a warm restart",
            "commands",
            answers,
        ),
        ("`standby`", "until commanded", "commands", answers),
        ("`acquire`", f"{device.acquisition_s:g} s, then `track`", "commands", measures),
        ("`track`", "until commanded", "commands", measures),
        ("`fault`", "until a reset; the interlock has opened", "commands", answers),
        ("`safe`", "until commanded or reset", "commands", answers),
    )
    if device.polled:
        first += (
            " It sends nothing unasked: each accepted `no_op` is answered with\nthe acknowledgement, housekeeping "
            "if it is due, and the last measurement unless that was sent already."
        )
    return f"### Modes\n\n{first}\n\n{_table(('mode', 'lasts', 'receives', 'sends'), rows)}"


def _commands(device: DeviceBehaviour, known: Iterable[str]) -> str:
    rows = (
        (f"`{name}`", ", ".join(device.modes_of_commands.get(name, ())) or "none: `out_of_state`")
        for name in known
    )
    return _table(("command", "is followed in"), rows)


def _times(device: DeviceBehaviour, known: Iterable[str]) -> str:
    rate_hz, settling = (
        device.housekeeping_rate_hz,
        f"not in shots that begin within {device.settling_s:g} s after it",
    )
    texts = {
        "Answer": "the acknowledgement leaves between two shots, mostly within 10 ms. No limit is guaranteed: wait for "
        "a second, then repeat.",
        "Repetition": "repeat with the same number. If the first one was received, the verdict is `bad_sequence`, and "
        "nothing is done twice.",
        "Effect": "with the next shot that begins after the command and whose packet can still be made, some 3 ms on.",
        "Housekeeping": f"{rate_hz:g} a second, at multiples of its period."
        if rate_hz
        else "none unless commanded.",
    }
    if "set_pattern" in known:
        texts["Change of pattern"] = f"beams fire {settling if device.settling_s else 'at once'}."
    if "reset" in known:
        texts["Restart"] = (
            "shot numbers begin at 0, the uptime too, and the next command may have any number. Counters of "
            "housekeeping and the sequence counts of acknowledgements and housekeeping go on."
        )
    if "time_at_tone" in known:
        texts["`time_at_tone`"] = (
            "there is no pulse; the time is that of the command's arrival."
            if device.pulse_line is None
            else f"the pulse is a rising edge of {device.pulse_line.upper()}, high for 1 ms at least; before the first "
            "one the time is that of the command's arrival."
        )
    return "\n".join(
        fill(f"* **{name}**: {text}", 120, subsequent_indent="  ", break_on_hyphens=False)
        for name, text in texts.items()
    )


def _names(interface: Interface) -> str:
    name, block, layout = identifier(interface), "beam", interface.packet.beam
    if layout is None:
        block, layout = "shot", interface.packet.header
    on_can = f"; on CAN `{name}_can.MESSAGE.NAME`" if interface.can else ""
    example = f"`{name}.{block}.{layout.placed[0].field.key}`"
    return f"With `lidar.lua` fields are named `{name}.BLOCK.NAME`, such as {example}{on_can}."


def _table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head, *lines = (f"| {' | '.join(cells)} |" for cells in (heading, *rows))
    return "\n".join([head, "|" + "---|" * len(heading), *lines])

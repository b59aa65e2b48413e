"""What a run shows: the port, what the loopback's far end decodes, and the summary."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any

import click

from lidar_emu.cli.far_end import Decoder, Screen, counter_line
from lidar_emu.cli.output import say
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import Outgoing, Report
from lidar_emu.runtime.summary import Tally
from lidar_protocol import Interface

_SHOW_EVERY_S = 0.5
_ERRORS = {"range": ("range_error_m", 1, "m"), "speed": ("speed_error_mps", 1000, "mm/s")}
"""Key of the summary, factor and unit."""


class Announcer(Observer):
    """Says which port was opened, before the first packet."""

    def __init__(self, name: str, pace: str, say: Callable[[str], None] = say) -> None:
        self._name, self._pace = name, pace
        self._say = say

    def on_waiting(self, port: str, what: str) -> None:
        """The port is open; the run begins with something that is waited for."""
        self._say(f"{self._name} on {port}, pace {self._pace}, waits for {what}; Ctrl-C ends it")

    def on_opened(self, port: str, start: datetime) -> None:
        """The port is open under this name."""
        self._say(
            f"{self._name} on {port}, pace {self._pace}, from {start:%Y-%m-%d %H:%M:%S} UTC; Ctrl-C ends it"
        )

    def on_process_event(self, time_ns: int, what: str) -> None:
        """A process stands still, or goes on."""
        self._say(_at(time_ns * 1e-9, what))


def _at(time_s: float, what: str) -> str:
    return f"{time_s:.3f} s: {what}"


class Progress(Observer):
    """A line on the terminal that says how far the run is."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._next_ns = 0

    def on_report(self, packet: Outgoing, report: Report) -> None:  # noqa: ARG002
        """Show the counts twice a second."""
        if report.due_ns >= self._next_ns:
            self._next_ns = report.due_ns + round(_SHOW_EVERY_S * 1e9)
            sent, late, dropped = self._tally.sent, self._tally.late, self._tally.dropped
            line = f"\r{report.due_ns * 1e-9:9.1f} s: {sent} sent, {late} late, {dropped} dropped "
            click.echo(line, nl=False, err=True)


class LoopbackView(Observer):
    """The far end of the in-memory loopback: decodes all, shows two lines a second."""

    def __init__(self, interface: Interface, quiet: bool) -> None:
        self._decoder = Decoder(interface)
        self._screen = None if quiet else Screen(_SHOW_EVERY_S, interface)

    def on_far_end_data(self, data: bytes) -> None:
        """Decode, and show what is due."""
        messages = self._decoder.decode(data)
        if self._screen is not None:
            self._screen.show(messages)

    def counters(self) -> dict[str, int]:
        """What the far end counted."""
        return self._decoder.counters()


def summary_lines(told: dict[str, Any]) -> list[str]:
    """The summary for the eye."""
    lines = ["", *shot_lines(told, _planned(told))]
    lines += lateness_lines(told["lateness"], told["steal_ticks"])
    lines += _truth(told["truth"])
    lines += _commands(told["commands"])
    lines += system_lines(told["granted"], told["missing"])
    lines += beam_lines(told)
    for name in _ERRORS:
        lines += [error_line(told, name), *_expected(told, name)]
    lines += traffic_lines(told)
    if told["final_message"] is not None:
        lines.append(f"final message {told['final_message']}")
    left_out = ", ".join(row["stage"] for row in told["left_out"])
    lines.append(f"left out   {left_out or 'nothing'} (lidar-emu plan says why)")
    if told["interrupted"]:
        lines.append("the run was interrupted")
    return lines


def traffic_lines(told: dict[str, Any]) -> list[str]:
    """What went over the link, what arrived, and what happened to the link and to the processes."""
    lines = []
    if told["wire"]["sent_bytes"] is not None:
        load = f", {100 * told['wire']['load']:.1f} % of the link" if told["wire"]["load"] else ""
        lines.append(f"wire       {told['wire']['sent_bytes']} bytes{load}")
    if any(told["far_end"].values()):
        lines.append(f"far end    {counter_line(told['far_end'])}")
    return lines + event_lines("link", told) + event_lines("process", told)


def shot_lines(told: dict[str, Any], planned: str = "") -> list[str]:
    """What became of the shots, and how many faults acted on them."""
    shots = told["shots"]
    suppressed = f", {shots['suppressed']} not fired by the device" if shots["suppressed"] else ""
    counts = f"{shots['sent']} sent, {shots['late']} late, {dropped_text(shots['dropped'])}{suppressed}"
    return [f"shots      {shots['due']} due{planned}: {counts}", *_faults(told["faults"])]


def beam_lines(told: dict[str, Any]) -> list[str]:
    """What became of each beam's measurements."""
    return [f"beam {beam:<6}{_reasons(counts)}" for beam, counts in enumerate(told["beams"])]


def error_line(told: dict[str, Any], name: str) -> str:
    """How far `range` or `speed` was off the truth."""
    key, factor, unit = _ERRORS[name]
    return f"{name:<10} error {_error(told[key], factor, unit)}"


def dropped_text(dropped: dict[str, int]) -> str:
    """How many packets the link did not take, and why."""
    why = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in dropped.items() if count)
    return f"{sum(dropped.values())} dropped" + (f" ({why})" if why else "")


def lateness_lines(lateness: dict[str, Any], steal_ticks: int | None) -> list[str]:
    """How late packets went out; nothing where none had a time to keep."""
    if not lateness["count"]:
        return []
    steal = "" if steal_ticks is None else f"; host steal {steal_ticks} ticks"
    windows = lateness["windows"]
    return [
        f"lateness   {_figures(lateness)}{steal}",
        f"{'':10} p99 of single seconds: median {_time(windows['p99_median_ns'])}, "
        f"worst {_time(windows['p99_worst_ns'])} at {windows['worst_at_s']} s",
    ]


def event_lines(whose: str, told: dict[str, Any]) -> list[str]:
    """What happened to the `link` or a `process`."""
    events, count = told[f"{whose}_events"], told[f"{whose}_event_count"]
    lines = [f"{whose:<10} {_at(event['time_s'], event['what'])}" for event in events]
    if count > len(events):
        lines.append(f"{whose:<10} {count} events in all: the first and the last are shown")
    return lines


def _planned(told: dict[str, Any]) -> str:
    return "" if told["planned_shots"] is None else f" of {told['planned_shots']} planned"


def _faults(told: dict[str, Any]) -> list[str]:
    if not told["shots"]:
        return []
    kinds = ", ".join(f"{kind.replace('_', ' ')} {count}" for kind, count in told["shots"].items())
    return [f"faults     on shots: {kinds}; {told['suppressed']} packets suppressed"]


def _truth(told: dict[str, Any] | None) -> list[str]:
    """What became of a simulator's truth, where there is one."""
    if told is None:
        return []
    refused = [
        f"{name.replace('_', ' ')} {count}"
        for name, count in (told["datagrams"] | {"lost": told["lost"], "jumped": told["jumped"]}).items()
        if count and name != "accepted"
    ]
    lines = [
        f"truth      {told['datagrams']['accepted']} accepted" + "".join(f", {text}" for text in refused)
    ]
    if told["age"]["count"]:
        age, stale = _figures(told["age"]), told["stale_shots"]
        lines.append(f"age        {age}" + (f"; stale in {stale} shots" if stale else ""))
    if told["response"]["count"]:
        lines.append(f"response   {_figures(told['response'])} from truth in to last byte written")
    return lines


def _commands(told: dict[str, Any] | None) -> list[str]:
    """What a host has commanded, if it has."""
    if told is None or not (told["accepted"] or told["rejected"]):
        return []
    rejected = "".join(f", {word.replace('_', ' ')} {count}" for word, count in told["rejected"].items())
    lines = [f"commands   {told['accepted']} accepted{rejected}"]
    if told["delay"]["count"]:
        lines.append(f"{'':10} {_figures(told['delay'])} from command to the first shot that follows it")
    return lines


def _figures(told: dict[str, Any]) -> str:
    labels = (("p50", "p50_ns"), ("p99", "p99_ns"), ("p99.9", "p99_9_ns"), ("max", "max_ns"))
    return ", ".join(f"{label} {_time(told[key])}" for label, key in labels)


def system_lines(granted: list[str], missing: dict[str, str]) -> list[str]:
    """What the port's process was given, and how to have the rest."""
    if not (granted or missing):
        return []
    had = ", ".join(granted).replace("_", " ") or "nothing"
    refused = ", ".join(f"{name.replace('_', ' ')} ({how})" for name, how in missing.items())
    return [f"granted    {had}" + (f"; not: {refused}" if refused else "")]


def _time(nanoseconds: int) -> str:
    return f"{nanoseconds / 1e3:.0f} us" if nanoseconds < 10_000_000 else f"{nanoseconds / 1e6:.1f} ms"


def _reasons(counts: dict[str, int]) -> str:
    total = sum(counts.values())
    return ", ".join(f"{name.replace('_', ' ')} {100 * n / total:.1f} %" for name, n in counts.items())


def _expected(told: dict[str, Any], name: str) -> list[str]:
    """A line, where there is an expectation."""
    key, factor, unit = _ERRORS[name]
    statistics = told[f"expected_{key}"]
    if statistics is None or statistics["rms"] is None:
        return []
    rms, mean = factor * statistics["rms"], factor * statistics["mean"]
    mean = mean if abs(mean) > 1e-9 * rms else 0.0  # what rounding leaves of nothing
    return [f"{'':10} expected {rms:.4g} {unit} rms, {mean:+.3g} {unit} mean, false locks aside"]


def _error(statistics: dict[str, Any], factor: float, unit: str) -> str:
    if not statistics["count"]:
        return "unknown: no valid measurement"
    rms, mean, largest = (factor * statistics[key] for key in ("rms", "mean", "max"))
    return f"{rms:.4g} {unit} rms, {mean:+.3g} {unit} mean, {largest:.4g} {unit} at most ({statistics['count']} values)"

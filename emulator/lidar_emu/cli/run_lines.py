"""Lines about a run: while it goes on, and the summaries of a run, a replay, a comparison and a recording."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import click

from lidar_emu.cli.messages import ShotPrinter, counter_line
from lidar_emu.cli.terminal import print_line
from lidar_emu.runtime.observer import EventSource, Observer
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket
from lidar_emu.runtime.summary import Tally
from lidar_emu.transports.messages import Decoder
from lidar_protocol import Interface

_ERRORS = {"range": ("range_error_m", 1, "m"), "speed": ("speed_error_mps", 1000, "mm/s")}
"""Key of the summary, factor and unit."""
_MOST_FREQUENT = 5


def at_time(time_s: float, what: str) -> str:
    """An event with its time."""
    return f"{time_s:.3f} s: {what}"


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """The summary of a run."""
    planned = "" if summary["planned_shots"] is None else f" of {summary['planned_shots']} planned"
    lines = ["", *shot_lines(summary, planned)]
    lines += lateness_lines(summary["lateness"], summary["steal_ticks"])
    lines += _truth(summary["truth"])
    lines += _commands(summary["commands"])
    lines += _host_messages(summary["host_messages"])
    lines += system_lines(summary["granted"], summary["missing"])
    lines += beam_lines(summary)
    for name in _ERRORS:
        lines += [error_line(summary, name), *_expected(summary, name)]
    lines += traffic_lines(summary)
    if summary["final_message"] is not None:
        lines.append(f"final message {summary['final_message']}")
    count = len(summary["left_out"])
    left_out = "1 effect, below its bound" if count == 1 else f"{count} effects, each below its bound"
    lines.append(f"left out   {left_out if count else 'nothing'} (lidar-emu plan)")
    if summary["interrupted"]:
        lines.append("the run was interrupted")
    return lines


def replay_lines(summary: dict[str, Any]) -> list[str]:
    """The summary of a replay."""
    packets = summary["packets"]
    lines = [
        "",
        f"packets    {packets['due']} due: {packets['sent']} sent, {packets['late']} late, "
        f"{dropped_text(packets['dropped'])}",
    ]
    if summary["left_out"]:
        left_out = (f"{name.replace('_', ' ')} {count}" for name, count in summary["left_out"].items())
        lines.append(f"left out   {', '.join(left_out)}")
    lines += lateness_lines(summary["lateness"], summary["steal_ticks"])
    lines += system_lines(summary["granted"], summary["missing"])
    lines += traffic_lines(summary)
    if summary["interrupted"]:
        lines.append("the replay was interrupted")
    return lines


def comparison_lines(summary: dict[str, Any]) -> list[str]:
    """The comparison of a recording with its recomputation."""
    not_compared = f", {summary['not_compared']} not compared" if summary["not_compared"] else ""
    lines = [
        f"packets    {summary['packets']} recorded: {summary['equal']} equal, "
        f"{summary['different']} different{not_compared}"
    ]
    first = summary["first"]
    if first is not None:
        beam = "" if first["beam"] is None else f", beam {first['beam']}"
        lines.append(
            f"first      shot {first['shot']}{beam}, {first['field']}: recorded {first['recorded']}, "
            f"computed {first['recomputed']}"
        )
    for name, (then, now) in summary["changed"].items():
        lines.append(f"changed    {name}: {then or 'none'} then, {now or 'none'} now")
    return lines


def contents_lines(summary: dict[str, Any]) -> list[str]:
    """The contents of a recording, in the terms of the run's summary."""
    started = datetime.fromisoformat(summary["started_utc"])
    state = (
        "complete" if summary["is_whole"] else "truncated: everything written before the truncation is here"
    )
    level = "" if summary["level"] is None else f", level {summary['level']}"
    return [
        f"file       {summary['file']}: {summary['size_bytes'] / 1e6:.1f} MB, {state}",
        f"flown      {summary['scenario']}, seed {summary['seed']}{level}: {summary['measured']} shots of "
        f"{summary['beam_count']} beams at {summary['rate_hz']:g} Hz, "
        f"{summary['from_s']:.3f} s to {summary['until_s']:.3f} s",
        f"port       {summary['port']}, pace {summary['pace']}, from {started:%Y-%m-%d %H:%M:%S} UTC, "
        f"lidar-emu {summary['version']}",
        *shot_lines(summary),
        *lateness_lines(summary["lateness"], None),
        *_counted("commands", [f"{each['command']} {each['verdict']}" for each in summary["commanded"]]),
        *_counted("injected", [f"fault {each['definition'].get('kind')}" for each in summary["injected"]]),
        *_counted("events", [f"{each['of']}: {each['what']}" for each in summary["events"]]),
        *beam_lines(summary),
        error_line(summary, "range"),
        error_line(summary, "speed"),
        f"telemetry  {summary['housekeeping_packets']} housekeeping packets",
    ]


def _counted(label: str, texts: list[str]) -> list[str]:
    """The most frequent texts with their counts."""
    if not texts:
        return []
    most = Counter(texts).most_common(_MOST_FREQUENT)
    shown = ", ".join(text + (f" ({count})" if count > 1 else "") for text, count in most)
    rest = len(texts) - sum(count for _, count in most)
    return [f"{label:<10} {shown}{f', {rest} more' if rest else ''}".replace("_", " ")]


def traffic_lines(summary: dict[str, Any]) -> list[str]:
    """Bytes sent, messages received, and events of the link and the processes."""
    from lidar_emu.transports.pseudo_terminal import READER_BUFFER_BYTES  # needs Linux, as a run does

    lines = []
    if summary["wire"]["sent_bytes"] is not None:
        load = f", {100 * summary['wire']['load']:.1f} % of the link" if summary["wire"]["load"] else ""
        unread = summary["wire"]["unread_bytes"]
        # What lies behind a full pty is not counted.
        least = "at least " if unread == READER_BUFFER_BYTES else ""
        lost = f", of which the host left {least}{unread} unread" if unread else ""
        lines.append(f"wire       {summary['wire']['sent_bytes']} bytes{load}{lost}")
    if any(summary["far_end"].values()):
        lines.append(f"far end    {counter_line(summary['far_end'])}")
    return lines + event_lines("link", summary) + event_lines("process", summary)


def shot_lines(summary: dict[str, Any], planned: str = "") -> list[str]:
    """Counts of shots by delivery status, and of faults."""
    shots = summary["shots"]
    suppressed = f", {shots['suppressed']} not fired by the device" if shots["suppressed"] else ""
    suppressed += f", {shots['not_polled']} not polled" if shots.get("not_polled") else ""
    counts = f"{shots['sent']} sent, {shots['late']} late, {dropped_text(shots['dropped'])}{suppressed}"
    lines, faults = [f"shots      {shots['due']} due{planned}: {counts}"], summary["faults"]
    if faults["shots"]:
        kinds = ", ".join(f"{kind.replace('_', ' ')} {count}" for kind, count in faults["shots"].items())
        held = f", {faults['held']} sent with the next one" if faults["held"] else ""
        lines.append(f"faults     on shots: {kinds}; {faults['suppressed']} packets suppressed{held}")
    return lines


def beam_lines(summary: dict[str, Any]) -> list[str]:
    """Validity of each beam's measurements, and false targets."""
    lines = []
    for beam, counts in enumerate(summary["beams"]):
        total = sum(counts.values())
        reasons = (f"{name.replace('_', ' ')} {100 * n / total:.1f} %" for name, n in counts.items())
        lines.append(f"beam {beam:<6}{', '.join(reasons)}")
    if summary["false_targets"]:
        valid = sum(counts.get("valid", 0) for counts in summary["beams"])
        shares = [
            f"{name.replace('_', ' ')} in {100 * count / valid:.1f} %"
            for name, count in summary["false_targets"].items()
        ]
        lines.append(f"false      {', '.join(shares)} of valid measurements")
    return lines


def error_line(summary: dict[str, Any], name: str) -> str:
    """Error of `range` or `speed` against the ground truth."""
    key, factor, unit = _ERRORS[name]
    count = summary[key]["count"]
    if not count:
        return f"{name:<10} error unknown: no valid measurement"
    rms, mean, most = (factor * summary[key][moment] for moment in ("rms", "mean", "max"))
    errors = f"{rms:.4g} {unit} rms, {mean:+.3g} {unit} mean, {most:.4g} {unit} at most"
    return f"{name:<10} error {errors} ({count} values)"


def dropped_text(dropped: dict[str, int]) -> str:
    """Number of dropped packets, and the reasons."""
    why = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in dropped.items() if count)
    return f"{sum(dropped.values())} dropped" + (f" ({why})" if why else "")


def why_nothing_sent(summary: dict[str, Any], what: str) -> str | None:
    """One line with the reasons why none of the `shots` or `packets` of a summary was sent; None if some were, if none
    was due, or if the user interrupted the run."""
    counts = summary[what]
    if counts["sent"] or not counts["due"] or summary["interrupted"]:
        return None
    by_faults = summary["faults"]["suppressed"] if "faults" in summary else 0
    not_fired = counts.get("suppressed", 0)
    not_polled = counts.get("not_polled", 0)
    causes = {
        "late": counts["late"],
        "not fired": not_fired,
        "not polled": not_polled,
        "suppressed by faults": by_faults,
    }
    texts = [f"{count} {cause}" for cause, count in causes.items() if count]
    if any(counts["dropped"].values()):
        texts.append(dropped_text(counts["dropped"]))
    return f"{summary['port']}: none of {counts['due']} {what} was sent: {', '.join(texts)}"


def lateness_lines(lateness: dict[str, Any], steal_ticks: int | None) -> list[str]:
    """Lateness of packets; nothing if none obtained a due time."""
    if not lateness["count"]:
        return []
    steal = "" if steal_ticks is None else f"; host steal {steal_ticks} ticks"
    windows = lateness["windows"]
    return [
        f"lateness   {_figures(lateness)}{steal}",
        f"{'':10} p99 of single seconds: median {_time(windows['p99_median_ns'])}, "
        f"worst {_time(windows['p99_worst_ns'])} at {windows['worst_at_s']} s",
    ]


def event_lines(source: str, summary: dict[str, Any]) -> list[str]:
    """Events of the `link`, a `process` or the `truth`."""
    events, count = summary[f"{source}_events"], summary[f"{source}_event_count"]
    lines = [f"{source:<10} {at_time(event['time_s'], event['what'])}" for event in events]
    if count > len(events):
        lines.append(f"{source:<10} {count} events in all: the first and the last are shown")
    return lines


def _truth(summary: dict[str, Any] | None) -> list[str]:
    if summary is None:
        return []
    counts = summary["datagrams"] | {name: summary[name] for name in ("lost", "jumped", "resumed", "ignored")}
    counted = [f"{counts.pop('accepted')} accepted"]
    counted += [f"{name.replace('_', ' ')} {count}" for name, count in counts.items() if count]
    lines = [f"truth      {', '.join(counted)}"]
    if summary["age"]["count"]:
        age, stale = _figures(summary["age"]), summary["stale_shots"]
        lines.append(f"age        {age}" + (f"; stale in {stale} shots" if stale else ""))
    if summary["response"]["count"]:
        lines.append(f"response   {_figures(summary['response'])} from truth in to last byte written")
    return lines + event_lines("truth", summary)


def _commands(summary: dict[str, Any] | None) -> list[str]:
    if summary is None or not (summary["accepted"] or summary["rejected"]):
        return []
    rejected = "".join(f", {word.replace('_', ' ')} {count}" for word, count in summary["rejected"].items())
    lines = [f"commands   {summary['accepted']} accepted{rejected}"]
    if summary["delay"]["count"]:
        lines.append(f"{'':10} {_figures(summary['delay'])} from command to the first shot affected")
    return lines


def _host_messages(summary: dict[str, Any] | None) -> list[str]:
    if summary is None:
        return []
    damage = {name: count for name, count in summary.items() if isinstance(count, int) and count}
    lines = []
    for name, counts in summary.items():
        if not isinstance(counts, dict) or not (counts["accepted"] or counts["rejected"]):
            continue
        others = {**counts["rejected"], "lost": counts["lost"], **damage}
        bad = "".join(f", {word.replace('_', ' ')} {count}" for word, count in others.items() if count)
        lines.append(f"{name:10} {counts['accepted']} received{bad}")
    return lines


def _figures(summary: dict[str, Any]) -> str:
    labels = (("p50", "p50_ns"), ("p99", "p99_ns"), ("p99.9", "p99_9_ns"), ("max", "max_ns"))
    return ", ".join(f"{label} {_time(summary[key])}" for label, key in labels)


def system_lines(granted: list[str], missing: dict[str, str]) -> list[str]:
    """Privileges that the system granted the port process, and how to get the others."""
    if not (granted or missing):
        return []
    obtained = ", ".join(granted).replace("_", " ") or "nothing"
    refused = ", ".join(f"{name.replace('_', ' ')} ({how})" for name, how in missing.items())
    return [f"granted    {obtained}" + (f"; not: {refused}" if refused else "")]


def _time(nanoseconds: int) -> str:
    return f"{nanoseconds / 1e3:.0f} us" if nanoseconds < 10_000_000 else f"{nanoseconds / 1e6:.1f} ms"


def _expected(summary: dict[str, Any], name: str) -> list[str]:
    key, factor, unit = _ERRORS[name]
    statistics = summary[f"expected_{key}"]
    if statistics is None or statistics["rms"] is None:
        return []
    rms, mean = factor * statistics["rms"], factor * statistics["mean"]
    mean = mean if abs(mean) > 1e-9 * rms else 0.0  # rounding residue of zero
    return [f"{'':10} expected {rms:.4g} {unit} rms, {mean:+.3g} {unit} mean, false locks excluded"]


_SHOW_EVERY_S = 0.5


class Announcer(Observer):
    """Prints the port and its events."""

    def __init__(self, name: str, pace: str, print_line: Callable[[str], None] = print_line) -> None:
        self._name, self._pace = name, pace
        self._print_line = print_line
        self._port = ""

    def on_waiting(self, port: str, what: str) -> None:
        self._announce(port, f"waits for {what}")

    def on_opened(self, port: str, start: datetime) -> None:
        # To the nearest second: two clocks give the start, a microsecond apart. It may be far ahead.
        shown = start + timedelta(seconds=0.5)
        self._announce(port, f"starts at {shown:%Y-%m-%d %H:%M:%S} UTC")

    def _announce(self, port: str, what: str) -> None:
        # Two lines: one would wrap on a terminal of 80 columns.
        if port != self._port:
            self._print_line(f"{self._name} on {port}, pace {self._pace}")
        self._port = port
        self._print_line(f"{what}; Ctrl-C ends it")

    def on_event(self, source: EventSource, time_ns: int, what: str) -> None:
        if source != "link":  # a flapping one has too many
            self._print_line(at_time(time_ns * 1e-9, what))


class ReadyLine(Observer):
    """Prints one line of JSON as soon as the port is open."""

    def on_ready(self, port: str) -> None:
        print_line(json.dumps({"ready": {"port": port}}))


class ProgressLine(Observer):
    """A line on the terminal with the time and the counts of a run."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._next_ns = 0

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:  # noqa: ARG002
        if report.due_ns >= self._next_ns:
            self._next_ns = report.due_ns + round(_SHOW_EVERY_S * 1e9)
            sent, late, dropped = self._tally.sent, self._tally.late, self._tally.dropped
            line = f"\r{report.due_ns * 1e-9:9.1f} s: {sent} sent, {late} late, {dropped} dropped "
            click.echo(line, nl=False, err=True)


class LoopbackView(Observer):
    """The far end of the in-memory loopback: decodes all packets, prints two shots a second."""

    def __init__(self, interface: Interface, quiet: bool) -> None:
        self._decoder = Decoder(interface)
        self._printer = None if quiet else ShotPrinter(_SHOW_EVERY_S, interface)

    def on_far_end_data(self, data: bytes) -> None:
        messages = self._decoder.decode(data)
        if self._printer is not None:
            self._printer.show(messages)

    def counters(self) -> dict[str, int]:
        """The decoder's counters."""
        return self._decoder.counters()

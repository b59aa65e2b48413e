"""What a recording holds, for the eye."""

from __future__ import annotations

from collections import Counter
from datetime import datetime
from typing import Any

from lidar_emu.cli.run_display import beam_lines, error_line, lateness_lines, shot_lines


def contents_lines(told: dict[str, Any]) -> list[str]:
    """A short table, in the words of the summary that the run has told."""
    started = datetime.fromisoformat(told["started_utc"])
    state = "whole" if told["is_whole"] else "cut short: all that was written until then is here"
    level = "" if told["level"] is None else f", level {told['level']}"
    return [
        f"file       {told['file']}: {told['size_bytes'] / 1e6:.1f} MB, {state}",
        f"flown      {told['scenario']}, seed {told['seed']}{level}: {told['measured']} shots of "
        f"{told['beam_count']} beams at {told['rate_hz']:g} Hz, {told['from_s']:.3f} s to {told['until_s']:.3f} s",
        f"port       {told['port']}, pace {told['pace']}, from {started:%Y-%m-%d %H:%M:%S} UTC, "
        f"lidar-emu {told['version']}",
        *shot_lines(told),
        *lateness_lines(told["lateness"], None),
        *_counted("commands", [f"{each['command']} {each['verdict']}" for each in told["commanded"]]),
        *_counted("ordered", [f"fault {each['definition'].get('kind')}" for each in told["ordered"]]),
        *_counted("events", [f"{each['of']}: {each['what']}" for each in told["events"]]),
        *beam_lines(told),
        error_line(told, "range"),
        error_line(told, "speed"),
        f"said       {told['said']} packets of housekeeping",
    ]


def _counted(label: str, texts: list[str]) -> list[str]:
    """The most frequent of them, by their count."""
    if not texts:
        return []
    most = Counter(texts).most_common(_NAMED)
    shown = ", ".join(text + (f" ({count})" if count > 1 else "") for text, count in most)
    rest = len(texts) - sum(count for _, count in most)
    return [f"{label:<10} {shown}{f', {rest} more' if rest else ''}".replace("_", " ")]


_NAMED = 5

"""What a replay shows at its end, and a comparison."""

from __future__ import annotations

from typing import Any

from lidar_emu.cli.run_display import dropped_text, lateness_lines, system_lines, traffic_lines


def replay_lines(told: dict[str, Any]) -> list[str]:
    """The summary of a replay for the eye."""
    packets = told["packets"]
    lines = [
        "",
        f"packets    {packets['due']} due: {packets['sent']} sent, {packets['late']} late, "
        f"{dropped_text(packets['dropped'])}",
    ]
    if told["left_out"]:
        lines.append(f"left out   {_counts(told['left_out'])}")
    lines += lateness_lines(told["lateness"], told["steal_ticks"])
    lines += system_lines(told["granted"], told["missing"])
    lines += traffic_lines(told)
    if told["interrupted"]:
        lines.append("the replay was interrupted")
    return lines


def comparison_lines(told: dict[str, Any]) -> list[str]:
    """What came of computing a run again."""
    not_compared = f", {told['not_compared']} not compared" if told["not_compared"] else ""
    lines = [
        f"packets    {told['packets']} recorded: {told['equal']} equal, {told['different']} different{not_compared}"
    ]
    first = told["first"]
    if first is not None:
        beam = "" if first["beam"] is None else f", beam {first['beam']}"
        lines.append(
            f"first      shot {first['shot']}{beam}, {first['field']}: recorded {first['recorded']}, "
            f"computed {first['recomputed']}"
        )
    for name, (then, now) in told["changed"].items():
        lines.append(f"changed    {name}: {then or 'none'} then, {now or 'none'} now")
    return lines


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in counts.items())

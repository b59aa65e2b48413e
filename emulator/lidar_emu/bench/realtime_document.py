"""The report of `bench realtime` as a JSON document."""

from __future__ import annotations

import os
import platform
from dataclasses import asdict
from typing import Any

from lidar_emu.bench.realtime import RealtimeReport
from lidar_emu.bench.realtime_statistics import (
    Side,
    counts_between,
    figures,
    histogram_edges_ns,
    late_without_control,
    median_excess_ns,
)


def realtime_document(report: RealtimeReport) -> dict[str, Any]:
    """All results except the single shots. Times are integer nanoseconds."""
    shots, summary = report.summary["shots"], report.summary
    return {
        "machine": {
            "cores": os.cpu_count(),
            "kernel": platform.release(),
            "python": platform.python_version(),
        },
        **asdict(report.options),
        "packet_bytes": report.packet_bytes,
        "interrupted": summary["interrupted"],
        "granted": summary["granted"],
        "missing": summary["missing"],
        "control_granted": report.control_granted,
        "steal_ticks": summary["steal_ticks"],
        "emulator": _side(report.emulator) | {"dropped": sum(shots["dropped"].values())},
        "control": _side(report.control),
        "windows": {
            "count": len(report.windows),
            "median_excess_p99_ns": median_excess_ns(report.windows),
            "late_where_control_had_none": late_without_control(report.windows),
            "each": [
                asdict(window) | {"steal_ticks": report.steal_by_second.get(window.at_s)}
                for window in report.windows
            ],
        },
        "histogram": _histogram(report),
    }


def _side(side: Side) -> dict[str, Any]:
    return {
        "due": len(side.due_ns),
        "late": int(side.late.sum()),
        "wake_up": figures(side.wake_up_ns()),
        "due_to_written": figures(side.due_to_written_ns()),
        "due_to_received": figures(side.due_to_received_ns()),
    }


def _histogram(report: RealtimeReport) -> dict[str, list[int]]:
    emulator, control = report.emulator.due_to_written_ns(), report.control.due_to_written_ns()
    edges = histogram_edges_ns(emulator, control)
    return {
        "edges_ns": edges.tolist(),
        "emulator": counts_between(emulator, edges).tolist(),
        "control": counts_between(control, edges).tolist(),
    }

"""The ray caster of elevation grids compared with ray tracers of triangles: times, errors, lost rays, build time.

All tools run on one core, if the system permits, and alternate call by call. lidar-emu has float64 in and out, with
range, normal, reflectance and object hit; the peers return distance, normal and triangle.

python -m benchmarks.casting    half a minute, 2 GB with both peers (pip install '.[peers]'); docs/evidence/casting.md
"""

from __future__ import annotations

import os
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.casting_exact import SiteFrame, exact_range_m, lunar_site
from benchmarks.casting_peers import Tracer, installed_peers
from benchmarks.casting_scene import (
    FOUR_BEAMS,
    KINDS,
    Rays,
    aimed_at_edges,
    rolling_ground,
    shots,
    triangles,
    unrelated,
)
from lidar_emu.bench.settings import median_times_s
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.runtime.clock import Clock
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.ray_hits import Hits

OURS, BILINEAR = "lidar-emu", "lidar-emu, bilinear"

_CELLS, _MANY_CELLS = 707, 2000
_SHOTS, _ROUNDS = 32, 40
_AIMED, _CHUNK = 1_000_000, 50_000
_EXACT_RAYS = 200
_NEAR_M, _FAR_M = 2_000.0, 10_000.0
_MOON_M = 1_737_400.0

Ranges = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Built:
    """Time and memory to build a scene."""

    time_s: float
    memory_mb: float | None
    """Peak memory including the samples; None if the system does not report it."""


@dataclass(frozen=True)
class CastingReport:
    """Figures by tool; a tool's error is a root mean square and a maximum, in metres."""

    absent: dict[str, str]
    """Peers that are not installed, and the reasons."""
    time_s: dict[str, dict[str, float]]
    """By kind of rays and tool: mean over different shots of the median time of a call."""
    error_m: dict[str, dict[str, tuple[float, float]]]
    """By place and tool, relative to exact fractions."""
    lost: dict[str, int]
    """How many of the `aimed` rays to vertices and edges hit nothing."""
    aimed: int
    built: dict[str, Built]
    """Half a million cells, a million triangles."""
    built_large: Built
    """lidar-emu, four million cells."""


def measure_casting() -> CastingReport:
    """Build, time and check all installed tools."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    builds, absent = installed_peers()
    _show("grids and trees")
    built = {OURS: _built(_CELLS)}
    ground, smooth = rolling_ground(_CELLS, "triangles"), rolling_ground(_CELLS, "bilinear")
    vertex_m, face = triangles(ground.samples)
    peers: dict[str, Tracer] = {}
    clock = Clock()
    for name, build in builds.items():
        start_ns, before_mb = clock.now_ns(), _resident_mb()
        peers[name] = build(vertex_m, face)
        grown_mb = None if before_mb is None else (_resident_mb() or 0.0) - before_mb
        built[name] = Built((clock.now_ns() - start_ns) * 1e-9, grown_mb)
    times = {}
    for kind in KINDS:
        _show(kind)
        times[kind] = _times_s({OURS: ground, BILINEAR: smooth}, peers, shots(kind, _SHOTS))
    tools: dict[str, Ranges] = {OURS: lambda o, d: ground.cast(o, d).range_m}
    tools |= {name: peer.range_m for name, peer in peers.items()}
    _show("errors")
    near, far = (unrelated(np.random.default_rng(3), _EXACT_RAYS, height_m) for height_m in (_NEAR_M, _FAR_M))
    errors = {"2 km": _errors(ground, tools, near), "10 km": _errors(ground, tools, far)}
    _show("errors in Moon-fixed coordinates")
    frame = lunar_site(0.44, -0.82, _MOON_M)
    fixed: dict[str, Ranges] = {
        OURS: lambda o, d: ground.cast(frame.to_site(o), frame.to_site(d, False)).range_m
    }
    fixed |= {name: build(frame.to_fixed(vertex_m), face).range_m for name, build in builds.items()}
    errors["2 km, Moon-fixed"] = _errors(ground, fixed, near, frame)
    _show("rays to vertices and edges")
    lost = dict.fromkeys((OURS, *peers), 0)
    rng = np.random.default_rng(4)
    for _ in range(_AIMED // _CHUNK):
        rays = aimed_at_edges(rng, ground, _CHUNK)
        lost[OURS] += int(np.isnan(ground.cast(rays.origin_m, rays.direction).range_m).sum())
        for name, peer in peers.items():
            lost[name] += int(np.isnan(peer.range_m(rays.origin_m, rays.direction)).sum())
    _show("four million cells")
    return CastingReport(absent, times, errors, lost, _AIMED, built, _built(_MANY_CELLS))


def ratio_to_embreex(report: CastingReport) -> float | None:
    """Time of embreex to ours for four beams on triangles; None: it is not installed."""
    time_s = report.time_s[FOUR_BEAMS]
    return time_s["embreex"] / time_s[OURS] if "embreex" in time_s else None


def _times_s(grounds: dict[str, GridGround], peers: dict[str, Tracer], rays: list[Rays]) -> dict[str, float]:
    """Median time of one call, by tool."""
    jobs: dict[str, list[Callable[[], object]]] = {}
    for name, ground in grounds.items():
        rooms = [Hits.empty(len(each.direction)) for each in rays]
        jobs[name] = [
            partial(ground.cast, each.origin_m, each.direction, room, each.bundle)
            for each, room in zip(rays, rooms, strict=True)
        ]
    for name, peer in peers.items():
        jobs[name] = [peer.prepare(each.origin_m, each.direction) for each in rays]
    # Shot by shot: scenes and tools stay warm.
    times = np.array([median_times_s(of_shot, _ROUNDS) for of_shot in zip(*jobs.values(), strict=True)])
    return dict(zip(jobs, times.mean(axis=0).tolist(), strict=True))


def _errors(
    ground: GridGround, tools: dict[str, Ranges], rays: Rays, frame: SiteFrame | None = None
) -> dict[str, tuple[float, float]]:
    """Root mean square and maximum by tool, of rays given in the site's axes or in the body's."""
    frame = frame or SiteFrame(np.eye(3), np.zeros(3))
    origin, direction = frame.to_fixed(rays.origin_m), frame.to_fixed(rays.direction, False)
    found = {name: ranges(origin, direction) for name, ranges in tools.items()}
    exact = []
    for k in range(len(origin)):
        ray = frame.exactly_to_site(origin[k]), frame.exactly_to_site(direction[k], False)
        exact.append(exact_range_m(ground.samples, *ray, float(found[OURS][k])))
    errors_m = {}
    for name, range_m in found.items():
        pairs = zip(range_m.tolist(), exact, strict=True)
        apart = np.array([float(Fraction(r) - t) for r, t in pairs if t is not None and r == r])
        errors_m[name] = float(np.sqrt((apart**2).mean())), float(np.abs(apart).max())
    return errors_m


def _built(cells: int) -> Built:
    samples = rolling_ground(cells, "bilinear").samples
    clock = Clock()
    start_ns = clock.now_ns()
    GridGround(samples, None, "", 0.0)
    time_s = (clock.now_ns() - start_ns) * 1e-9
    tracemalloc.start()
    GridGround(samples, None, "", 0.0)
    peak_mb = (tracemalloc.get_traced_memory()[1] + samples.height_m.nbytes) / 1e6
    tracemalloc.stop()
    return Built(time_s, peak_mb)


def _resident_mb() -> float | None:
    """Memory of this process, if the system reports it."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return None


def _show(what: str) -> None:
    print(what, file=sys.stderr, flush=True)


def print_report(report: CastingReport) -> None:
    """Print times, errors, and the cost of building, as tables of Markdown."""
    tools = list(report.built)
    peers = [name for name in tools if name != OURS]
    _print_heading("us per call (times triangles)", "triangles", "bilinear", *peers)
    for kind, time_s in report.time_s.items():
        cells = [f"{1e6 * time_s[name]:.1f}" for name in (OURS, BILINEAR)]
        cells += [f"{1e6 * time_s[name]:.1f} ({time_s[name] / time_s[OURS]:.1f})" for name in peers]
        _print_row(kind, *cells)
    _print_heading("", *tools)
    for place, error_m in report.error_m.items():
        cells = [f"{rms:.1g} ({most:.1g})" for rms, most in (error_m[name] for name in tools)]
        _print_row(f"error at {place}, rms (max), m", *cells)
    _print_row(f"lost of {report.aimed:,} to edges", *(str(report.lost[name]) for name in tools))
    _print_row("ready in s", *(f"{report.built[name].time_s:.2g}" for name in tools))
    _print_row("memory", *(_memory(report.built[name]) for name in tools))
    large = report.built_large
    print(f"\nfour million cells: ready in {large.time_s:.2g} s and {_memory(large)}")
    for name, why in report.absent.items():
        print(f"{name}: left out, {why} (pip install '.[peers]')")
    if (ratio := ratio_to_embreex(report)) is not None:
        print(f"ratio: {ratio:.3g} (time of embreex to ours, {FOUR_BEAMS} on triangles)")


def _print_heading(*cells: str) -> None:
    print()
    _print_row(*cells)
    print("|" + "---|" * len(cells))


def _print_row(*cells: str) -> None:
    print(f"| {' | '.join(cells)} |")


def _memory(built: Built) -> str:
    return "-" if built.memory_mb is None else f"{built.memory_mb:.0f} MB"


if __name__ == "__main__":
    print_report(measure_casting())

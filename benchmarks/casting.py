"""The ray caster of elevation grids compared with ray tracers of triangles: times, errors, lost rays, build time.

All tools run on one core, if the system permits, and take turns. lidar-emu has float64 in and out, with range, normal,
reflectance and object hit; the peers return distance, normal and triangle.

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
from benchmarks.tables import command_line
from lidar_emu.bench.settings import median_times_s
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.runtime.clock import Clock
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.ray_hits import Hits

OURS, BILINEAR, CALLED = "lidar-emu", "lidar-emu, bilinear", "lidar-emu, a call a shot"
IN_ONE_CALL = ", one call"

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
    """By kind of rays and tool: time of a shot."""
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


def _times_s(grounds: dict[str, GridGround], peers: dict[str, Tracer], rays: list[Rays]) -> dict[str, float]:
    """Median time of all shots, divided by their number, by tool.

    lidar-emu has all shots in one call, in which the kernel casts beam by beam: a run calls it from compiled code, too.
    The tools take turns, each twice: the second time, which counts, its scene is in the processor's caches as in a run.
    """
    every = Rays(
        *(np.concatenate(arrays) for arrays in zip(*(each[:2] for each in rays), strict=True)), rays[0].bundle
    )
    jobs = {name: _casts(ground, [every]) for name, ground in grounds.items()}
    jobs[CALLED] = _casts(grounds[OURS], rays)
    for name, peer in peers.items():
        jobs[name] = [peer.prepare(each.origin_m, each.direction) for each in rays]
        jobs[name + IN_ONE_CALL] = [peer.prepare(every.origin_m, every.direction)]
    twice = [partial(_call, calls) for calls in jobs.values() for _ in range(2)]
    times_s = np.array(median_times_s(twice, _ROUNDS)[1::2]) / len(rays)
    return dict(zip(jobs, times_s.tolist(), strict=True))


def _casts(ground: GridGround, rays: list[Rays]) -> list[Callable[[], object]]:
    return [partial(ground.cast, *each[:2], Hits.empty(len(each.direction)), each.bundle) for each in rays]


def _call(calls: list[Callable[[], object]]) -> None:
    for call in calls:
        call()


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
    for kind, time_s in report.time_s.items():
        if kind == next(iter(report.time_s)):
            _print_heading("us per shot (times lidar-emu)", *time_s)
        ratios = {name: "" if name == OURS else f" ({time_s[name] / time_s[OURS]:.2g})" for name in time_s}
        _print_row(kind, *(f"{1e6 * time_s[name]:.1f}{ratio}" for name, ratio in ratios.items()))
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
    time_s = report.time_s[FOUR_BEAMS]
    if "embreex" in time_s:
        called, at_once = (time_s[name] / time_s[OURS] for name in ("embreex", "embreex" + IN_ONE_CALL))
        what = f"time of embreex to ours, {FOUR_BEAMS} on triangles"
        print(f"ratio: {called:.3g} ({what}; {at_once:.3g} with {_SHOTS} shots in one call of embreex)")


def _print_heading(*cells: str) -> None:
    print()
    _print_row(*cells)
    print("|" + "---|" * len(cells))


def _print_row(*cells: str) -> None:
    print(f"| {' | '.join(cells)} |")


def _memory(built: Built) -> str:
    return "-" if built.memory_mb is None else f"{built.memory_mb:.0f} MB"


if __name__ == "__main__":
    command_line(__doc__).parse_args()
    print_report(measure_casting())

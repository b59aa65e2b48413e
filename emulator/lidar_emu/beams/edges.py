"""Footprints on several surfaces: cells of beamlets are cut where one surface ends and another begins.

A beamlet stands for the part of the footprint that is nearest to it, its cell. Where neighbours hit different surfaces,
many more rays, each with the same share of the beam's power, count how much of each cell's light falls on the surface
of its beamlet. The rest is the cell's second part, with a hit, a closing speed and speckle of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple, Self

import numpy as np

from lidar_emu.beams.footprint import beamlet_pattern, sample_footprint
from lidar_emu.beams.pointing import Pointing
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import dot, subtract
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scene.ray_hits import Hits

_RAYS = 256
"""Rays of a footprint on several surfaces."""
_STEP_M, _SPEED_MPS, _CONTRAST = 0.03, 1e-3, 0.1
"""Step along the beam, difference of closing speed, and of albedo as a share of the greater, of different surfaces: a
tenth of a bin of 0.3 m. Another instrument may measure a recorded geometry, so that they do not depend on its bins."""
_LEAST_COSINE = 0.25
"""Cosine of incidence below which a facet is not continued to the next ray: it would reach any depth."""


class Cuts(NamedTuple):
    """Beams of n beamlets with cells that are cut. Columns 0 to n - 1 are the beamlets, n to 2n - 1 the second parts of
    their cells."""

    beam: IntArray
    """(cut,) Their numbers among shots · beams, in ascending order."""
    weight: FloatArray
    """(cut, 2n) Fraction of the beam's power; 0 for the second part of a whole cell."""
    place: IntArray
    """(cut, n) Row of `ray_places` of the ray that stands for a second part; -1 in a whole cell."""

    @classmethod
    def unfilled(cls, cut: int, beamlets: int) -> Self:
        """Allocate arrays."""
        return cls(
            np.empty(cut, np.int64), np.empty((cut, 2 * beamlets)), np.empty((cut, beamlets), np.int64)
        )


CutBeams = tuple[Cuts, Hits]
"""Cuts, and hits (cut · 2n,) of all columns."""


@cache
def ray_places(beamlets: int) -> tuple[FloatArray, IntArray]:
    """Offsets (rays, 2) of rays of equal power in units of the 1/e² radius, and the cell (rays,) of each.

    The rays are on a spiral that turns by the golden angle from one to the next, so that straight lines in any
    direction divide them evenly. Those nearest to their beamlets come first.
    """
    number = np.arange(_RAYS)
    away_w = np.sqrt(-0.25 * np.log(1.0 - (number + 0.5) / _RAYS))
    turn = np.pi * (3.0 - np.sqrt(5.0)) * number
    offset_w = away_w[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    to_beamlet_w = np.hypot(*np.moveaxis(offset_w[:, None] - beamlet_pattern(beamlets)[0], -1, 0))
    order = np.argsort(to_beamlet_w.min(axis=1), kind="stable")
    return offset_w[order], to_beamlet_w[order].argmin(axis=1)


class _Surfaces(NamedTuple):
    """Rays and the surfaces that they hit, for kernels."""

    start_m: FloatArray
    ray: FloatArray
    range_m: FloatArray
    normal: FloatArray
    albedo: FloatArray
    velocity_mps: FloatArray


def _surfaces(rays: tuple[FloatArray, FloatArray], hits: Hits) -> tuple[FloatArray, ...]:
    return *rays, hits.range_m, hits.normal_site, hits.reflectance, hits.velocity_site_mps


class CellCutter:
    """Cuts the cells of an instrument's beamlets.

    Args:
        cast_rays: `Flight.cast_rays`.
        beamlets: beamlets per beam, at least 7.
    """

    def __init__(self, cast_rays: Callable[..., Hits], instrument: Instrument, beamlets: int) -> None:
        self._cast_rays, self._beamlets = cast_rays, beamlets
        self._optics = instrument.optics.waist_radius_m, instrument.waveform.wavelength_m
        self._offset_w, self._cell = ray_places(beamlets)
        pattern_w, _ = beamlet_pattern(beamlets)
        apart_w = np.hypot(*np.moveaxis(pattern_w[:, None] - pattern_w, -1, 0))
        self._neighbour = np.argwhere(np.triu(apart_w < 1.01 * apart_w[0, 1], 1))

    def cut(
        self, pointing: Pointing, axis_range_m: FloatArray, rays: tuple[FloatArray, FloatArray], hits: Hits
    ) -> CutBeams | None:
        """Cut the cells of beams; None if all are whole.

        Args:
            axis_range_m: (shots, beams) ranges along the axes.
            rays: starts and directions (shots · beams · n, 3) of the beamlets.
            hits: (shots · beams · n,) of the beamlets.
        """
        seen, several = _surfaces(rays, hits), np.empty(axis_range_m.size, dtype=np.bool_)
        _find(self._neighbour, seen, several)
        if not several.any():
            return None
        n, (beam,) = self._beamlets, np.nonzero(several)
        sensor_m, axis = (v.reshape(-1, 3)[beam] for v in (pointing.sensor_site_m, pointing.true_site))
        sampled = sample_footprint(
            sensor_m, axis, axis_range_m.reshape(-1)[beam], self._offset_w[None], *self._optics
        )
        more_rays = sampled.start_site_m.reshape(-1, 3), sampled.ray_site.reshape(-1, 3)
        more_hits = self._cast_rays(pointing.time_ns.reshape(-1)[beam], *more_rays)
        cuts = Cuts.unfilled(len(beam), n)
        _weigh(beam, seen, _surfaces(more_rays, more_hits), self._cell, cuts.weight, cuts.place)
        (row,) = np.nonzero((cuts.place >= 0).any(axis=1))
        if not row.size:
            return None
        cuts = Cuts(beam[row], cuts.weight[row], cuts.place[row])
        parts, column = (
            Hits.none(cuts.weight.size, hits.moving),
            np.arange(cuts.weight.size).reshape(-1, 2 * n),
        )
        parts.set_rows(column[:, :n], hits.shaped((several.size, n)).chosen(cuts.beam))
        cut, cell = np.nonzero(cuts.place >= 0)
        parts.set_rows(column[cut, n + cell], more_hits.chosen(_RAYS * row[cut] + cuts.place[cut, cell]))
        return cuts, parts


@kernel(outermost=True)
def _find(neighbour: IntArray, surfaces: tuple[FloatArray, ...], several: BoolArray) -> None:
    """Set whether the beamlets of each beam hit different surfaces."""
    seen = _Surfaces(*surfaces)
    beamlets = len(seen.range_m) // len(several)
    for b in range(len(several)):
        first = b * beamlets
        several[b] = False
        for i in range(1, beamlets):
            # Within half the limit of one plane no two beamlets differ.
            if not _is_on_facet(seen, first, first + i):
                several[b] = True
                break
        if not several[b]:
            continue
        several[b] = False
        for pair in range(len(neighbour)):
            if _differ(seen, first + neighbour[pair, 0], seen, first + neighbour[pair, 1]):
                several[b] = True
                break


@kernel
def _is_on_facet(seen: _Surfaces, a: int, b: int) -> bool:
    if not (seen.range_m[a] >= 0.0 and seen.range_m[b] >= 0.0):
        return not (seen.range_m[a] >= 0.0 or seen.range_m[b] >= 0.0)
    still = seen.velocity_mps.size == 0 or _speed_apart(seen, a, seen, b) == 0.0
    return still and seen.albedo[a] == seen.albedo[b] and abs(_beyond_m(seen, a, seen, b)) < 0.5 * _STEP_M


@kernel(outermost=True)
def _weigh(
    beam: IntArray,
    surfaces: tuple[FloatArray, ...],
    more_surfaces: tuple[FloatArray, ...],
    cell: IntArray,
    weight: FloatArray,
    place: IntArray,
) -> None:
    """Set weights and places of `Cuts`, from the surfaces of all beams' beamlets and of these beams' rays."""
    seen, more = _Surfaces(*surfaces), _Surfaces(*more_surfaces)
    weight[:] = 0.0
    place[:] = -1
    n = place.shape[1]
    for b in range(len(beam)):
        for ray in range(len(cell)):
            column = cell[ray]
            if _differ(seen, beam[b] * n + column, more, b * len(cell) + ray):
                if place[b, column] < 0:
                    place[b, column] = ray
                column += n
            weight[b, column] += 1.0 / len(cell)


@kernel
def _differ(seen: _Surfaces, a: int, others: _Surfaces, b: int) -> bool:
    """Whether the surfaces of two rays differ in albedo or speed, or do not meet between the rays.

    The step between the two facets is linear from one ray to the other: facets of a crease meet where it is 0.
    """
    hit_a, hit_b = seen.range_m[a] >= 0.0, others.range_m[b] >= 0.0
    if not (hit_a and hit_b):
        return bool(hit_a != hit_b)
    if _albedo_apart(seen, a, others, b) > 1.0 or _speed_apart(seen, a, others, b) > _SPEED_MPS:
        return True
    at_b_m, at_a_m = _beyond_m(seen, a, others, b), -_beyond_m(others, b, seen, a)
    if max(abs(at_a_m), abs(at_b_m)) <= _STEP_M:
        return False
    if abs(dot(seen.normal[a], seen.ray[a])) < _LEAST_COSINE:
        at_b_m = others.range_m[b] - seen.range_m[a]
    if abs(dot(others.normal[b], others.ray[b])) < _LEAST_COSINE:
        at_a_m = others.range_m[b] - seen.range_m[a]
    return bool(at_a_m * at_b_m > 0.0 and min(abs(at_a_m), abs(at_b_m)) > _STEP_M)


@kernel
def _beyond_m(seen: _Surfaces, a: int, others: _Surfaces, b: int) -> float:
    """Distance of the hit of ray b behind the plane of the facet that ray a hits, along ray b."""
    facet = seen.normal[a]
    ahead_m = seen.range_m[a] * dot(facet, seen.ray[a]) + dot(
        facet, subtract(seen.start_m[a], others.start_m[b])
    )
    return float(others.range_m[b] - ahead_m / dot(facet, others.ray[b]))


@kernel
def _albedo_apart(seen: _Surfaces, a: int, others: _Surfaces, b: int) -> float:
    """Difference of albedos, 1 if just different."""
    one, other = seen.albedo[a], others.albedo[b]
    return float(abs(one - other) / (_CONTRAST * max(one, other, 1e-9)))


@kernel
def _speed_apart(seen: _Surfaces, a: int, others: _Surfaces, b: int) -> float:
    if seen.velocity_mps.size == 0:
        return 0.0
    return float(abs(dot(subtract(seen.velocity_mps[a], others.velocity_mps[b]), seen.ray[a])))

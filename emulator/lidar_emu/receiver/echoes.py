"""Echoes of the beamlets of each beam: power, range, closing speed and speckle at the time of validity.

The sensor moves with v, and a beam points along u, which rotates with u' = ω x u. The echo of a fixed point of the
ground, at the distance s along the axis and x across it, has the phase 2k L with L = s + x²/(2 Rc), where Rc is the
radius of the beam's wavefront. Its closing speed -dL/dt is, to first order in x,

    v·u + x·(v/Rc - (1 - R/Rc) u').

Speckle: as the footprint moves by D over the ground, its scatterers are exchanged, which gives the echo field the
correlation exp(-D²/w²). With the beamlets' own closing speeds the correlation is exp(-d²/w0²) for a sensor that moves
by d across the beam, exp(-(π w0 θ/λ)²) for one that rotates by θ, at any range, and the product for both. The process
is stationary: the acceleration of a fixed point that crosses the footprint does not appear in it, and within a record,
too, frequencies change by the closing acceleration along the axis alone.

Where the surface moves, v is the velocity of the sensor relative to it.
"""

from __future__ import annotations

from math import hypot, inf, log, nan, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.edges import CellCutter, CutBeams, ray_places
from lidar_emu.beams.flight import Flight
from lidar_emu.beams.footprint import Footprint, beamlet_pattern, sample_footprint
from lidar_emu.beams.pointing import Pointing, beam_vectors, chirp_beams
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray, as_record
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.lazy_kernel import ArrayFunction
from lidar_emu.numerics.vectors import Vector, add, cross, dot, nan_to_zero, scale, subtract, vector_at
from lidar_emu.receiver.link_budget import echo_law, echo_power_w
from lidar_emu.receiver.returns import FACE, Echoes
from lidar_emu.receiver.speckle_field import set_place
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.site import Site
from lidar_emu.scene.ray_hits import Hits

LEAST_COSINE = 1e-3
"""Minimum cosine of incidence (89.94 degrees) in the slide of a beamlet over its facet, which diverges at grazing
incidence."""


LEAST_FADE, NO_FADE = 1e-3, 1e-9
"""Correlation of the echo's power in consecutive shots that may be left out, and which is none."""


class BeamletHits(NamedTuple):
    """Origins, directions and hits of beamlets (shots, beams, beamlets)."""

    start_site_m: FloatArray
    """(shots, beams, beamlets, 3) Origins."""
    ray_site: FloatArray
    """(shots, beams, beamlets, 3) Unit directions."""
    hits: Hits


class EchoModel:
    """The echoes of an instrument over a site.

    Args:
        beamlets: beamlets per beam.
        receiving_lag: whether echoes are dimmed by the rotation of the beam while the light travels.
        least_fade: correlation of the echo's power from shot to shot below which each shot has its own speckle.
    """

    def __init__(
        self,
        instrument: Instrument,
        site: Site,
        flight: Flight,
        beamlets: int,
        receiving_lag: bool = True,
        least_fade: float = LEAST_FADE,
    ) -> None:
        self._flight, self._beamlets = flight, beamlets
        self._cutter: CellCutter | None = None
        if site.has_edges and beamlets > 1:
            self._cutter = CellCutter(flight.cast_rays, instrument, beamlets)
        self.columns = beamlets if self._cutter is None else 2 * beamlets
        self.cut_beams: CutBeams | None = None
        self._waist_m, self._wavelength_m = instrument.optics.waist_radius_m, instrument.waveform.wavelength_m
        law = echo_law(instrument, site.surface, site.atmosphere)
        self._law = as_record(law if receiving_lag else law._replace(lag_s_per_m2=0.0))
        self._segment_s = instrument.waveform.segment_time_s
        # Time of the square of the motion that lowers exp(-2D²/w0²) to this correlation.
        self._forgotten_s2 = (1e-9 * flight.period_ns) ** 2 / (-0.5 * log(least_fade))
        self._allocate(0, 0)

    def _allocate(self, shots: int, beams: int) -> None:
        """Allocate arrays for blocks of this shape, overwritten by each block."""
        weight = beamlet_pattern(self._beamlets)[1]
        self._footprint = Footprint.unfilled(shots * beams, weight)
        self._footprint_arrays = tuple(self._footprint._replace(weight=weight[None]))
        self._cast_hits = Hits.empty(shots * beams * self._beamlets, self._flight.has_moving_objects)
        self._hits = self._cast_hits
        self._echoes = _unfilled(shots, beams, self.columns)

    @property
    def beamlet_hits(self) -> BeamletHits:
        """Hits of the beamlets of the last echoes, valid until the next call, and of second parts where cells are
        cut."""
        shots, beams, columns = self._echoes.range_m.shape
        starts_m, rays, hits = self._footprint.start_site_m, self._footprint.ray_site, self._hits
        if self._cutter is not None:
            rows = np.arange(shots * beams * columns).reshape(-1, columns)
            beamlets, hits = hits, Hits.none(rows.size, hits.moving)
            hits.set_rows(rows[:, : self._beamlets].ravel(), beamlets)
            starts_m, rays = (np.pad(v, ((0, 0), (0, self._beamlets), (0, 0))) for v in (starts_m, rays))
            if self.cut_beams is not None:
                cuts, of_parts = self.cut_beams
                hits.set_rows(rows[cuts.beam].ravel(), of_parts)
                starts_m[cuts.beam], rays[cuts.beam] = self._cut_footprint[1:3]
        shape = shots, beams, columns
        return BeamletHits(starts_m.reshape(*shape, 3), rays.reshape(*shape, 3), hits.shaped(shape))

    def cast_beamlets(self, pointing: Pointing, axis_hits: Hits) -> Hits:
        """Cast the beamlets around axes that hit at `axis_hits`, and cut cells: hits (rays,), valid until the next
        call."""
        hits = self._cast(pointing, axis_hits)
        if self._cutter is not None:
            self._cut(pointing, axis_hits.range_m, self._footprint, hits)
        return hits

    def _cut(self, pointing: Pointing, range_m: FloatArray, footprint: Footprint, hits: Hits) -> None:
        assert self._cutter is not None
        rays = footprint.start_site_m.reshape(-1, 3), footprint.ray_site.reshape(-1, 3)
        self.cut_beams = self._flight.cut_cells(self._cutter, pointing, range_m, rays, hits)

    def _cast(self, pointing: Pointing, axis_hits: Hits) -> Hits:
        shots, beams = axis_hits.range_m.shape
        if self._echoes.fired.shape != (shots, beams):
            self._allocate(shots, beams)
        footprint = self._footprint
        sample_footprint(
            pointing.sensor_site_m.reshape(-1, 3),
            pointing.true_site.reshape(-1, 3),
            axis_hits.range_m.reshape(-1),
            self._beamlets,
            self._waist_m,
            self._wavelength_m,
            footprint,
        )
        if self._beamlets == 1:
            self._hits = axis_hits.shaped((shots * beams,))
            return self._hits
        rays = footprint.start_site_m.reshape(-1, 3), footprint.ray_site.reshape(-1, 3)
        self._hits = self._flight.cast_beamlets(pointing, *rays, self._cast_hits)
        return self._hits

    def echoes(self, pointing: Pointing, axis_hits: Hits) -> Echoes:
        """Compute the echoes of beams (shots, beams) whose axes hit at `axis_hits`, valid until the next call."""
        hits, echoes = self._cast(pointing, axis_hits), self._echoes
        axes = pointing.fired, axis_hits.inside, axis_hits.range_m
        self._set(pointing.beams, pointing.time_ns, axes, self._footprint_arrays, hits, echoes)
        if self._cutter is not None:
            ArrayFunction(self._set_cut)(pointing, axis_hits.range_m, self._footprint, hits, echoes)
        if pointing.at_chirps.size:
            _follow_chirps(
                self._segment_s,
                pointing.beams,
                pointing.at_chirps,
                axis_hits.range_m,
                axis_hits.normal_site,
                axis_hits.velocity_site_mps,
                tuple(echoes),
            )
        return echoes

    def _set(
        self,
        stacked: FloatArray,
        time_ns: IntArray,
        axes: tuple[BoolArray, BoolArray, FloatArray],
        footprint: tuple[Any, ...],
        hits: Hits,
        echoes: Echoes,
    ) -> None:
        surfaces = hits.range_m, hits.normal_site, hits.velocity_site_mps, hits.reflectance
        _set_echoes(self._law, stacked, time_ns, axes, footprint, surfaces, self._forgotten_s2, tuple(echoes))

    def _set_cut(
        self, pointing: Pointing, range_m: FloatArray, rays: Footprint, beamlets: Hits, echoes: Echoes
    ) -> None:
        """Cut cells, and set the echoes of beams that have any."""
        self._cut(pointing, range_m, rays, beamlets)
        if self.cut_beams is None:
            return
        cuts, hits = self.cut_beams
        stacked = np.take(pointing.beams.reshape(6, 1, -1, 3), cuts.beam, axis=2)
        time_ns, range_m = pointing.time_ns.reshape(1, -1)[:, cuts.beam], range_m.reshape(1, -1)[:, cuts.beam]
        axes = np.ones(range_m.shape, dtype=np.bool_), np.zeros(range_m.shape, dtype=np.bool_), range_m
        sensor_m, axis = (pointing.sensor_site_m.reshape(-1, 3), pointing.true_site.reshape(-1, 3))
        beamlet_w = np.broadcast_to(beamlet_pattern(self._beamlets)[0], (*cuts.place.shape, 2))
        footprint = sample_footprint(
            sensor_m[cuts.beam],
            axis[cuts.beam],
            range_m[0],
            np.concatenate([beamlet_w, ray_places(self._beamlets)[0][cuts.place]], axis=1),
            self._waist_m,
            self._wavelength_m,
        )
        self._cut_footprint = footprint._replace(weight=cuts.weight)
        parts = _unfilled(1, len(cuts.beam), self.columns)
        self._set(stacked, time_ns, axes, tuple(self._cut_footprint), hits, parts)
        for name in ("range_m", "closing_speed_mps", "power_w", "range_rate_mps"):
            getattr(echoes, name).reshape(-1, self.columns)[cuts.beam] = getattr(parts, name)[0]


def _unfilled(shots: int, beams: int, columns: int) -> Echoes:
    shape, each = (shots, beams), (shots, beams, columns)
    return Echoes(
        range_m=np.empty(each),
        closing_speed_mps=np.empty(each),
        power_w=np.empty(each),
        range_rate_mps=np.empty(each),
        closing_acceleration_mps2=np.empty(shape),
        closing_jerk_mps3=np.zeros(shape),
        range_curvature_mps2=np.zeros(shape),
        air_speed_mps=np.empty(shape),
        speckle_place=np.empty((*shape, 6)),
        speckle_motion=np.empty((*shape, 3)),
        fired=np.empty(shape, dtype=np.bool_),
        inside=np.empty(shape, dtype=np.bool_),
    )


def compute_echoes(
    instrument: Instrument, site: Site, flight: Flight, beamlets: int, pointing: Pointing, axis_hits: Hits
) -> Echoes:
    """Compute the echoes of beams (shots, beams) of `beamlets` beamlets each, whose axes hit at `axis_hits`."""
    return EchoModel(instrument, site, flight, beamlets).echoes(pointing, axis_hits)


@kernel(outermost=True)
def _set_echoes(
    laws: NDArray[Any],
    stacked: FloatArray,
    time_ns: IntArray,
    axes: tuple[BoolArray, BoolArray, FloatArray],
    footprint_arrays: tuple[Any, ...],
    surfaces: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    forgotten_s2: float,
    echo_arrays: tuple[Any, ...],
) -> None:
    """Set the arrays of `Echoes`. Columns behind the footprint's have no light.

    Args:
        laws: (1,) record of an `EchoLaw`.
        forgotten_s2: see `EchoModel`.
        stacked: see `Pointing.beams`.
        axes: whether the beams fire, whether their sensors are below the ground, and the ranges of their axes.
        footprint_arrays, echo_arrays: plain tuples, whose types numba resolves faster than a named tuple's. Weights are
            (beams or 1, beamlets).
        surfaces: ranges, normals, velocities and reflectances of the beamlets' `Hits`, (rays,).
    """
    law, vectors = laws[0], beam_vectors(stacked)
    footprint, echoes = Footprint(*footprint_arrays), Echoes(*echo_arrays)
    waist_m, rayleigh_m = law.waist_m, law.rayleigh_m
    ranges_m, normals, surface_mps, reflectance = surfaces
    fired, inside, axis_range_m = axes
    range_m, across = echoes.range_m, footprint.across_site
    doppler_start_m = footprint.doppler_start_m
    shots, beams, columns = range_m.shape
    beamlets = footprint.ray_site.shape[1]
    for s in range(shots):
        for b in range(beams):
            beam = s * beams + b
            axis, first, second = vectors.true[s, b], across[0, beam], across[1, beam]
            sensor, velocity, away_m = vectors.sensor_m[s, b], vectors.velocity_mps[s, b], axis_range_m[s, b]
            echoes.fired[s, b], echoes.inside[s, b] = fired[s, b], inside[s, b]
            echoes.air_speed_mps[s, b] = dot(velocity, axis) - dot(law.wind_mps, axis)
            swing_radps = cross(vectors.turning_radps[s, b], axis)
            on_axis = beam * beamlets
            first_mps = _relative_speed(surface_mps, on_axis, velocity, first)
            second_mps = _relative_speed(surface_mps, on_axis, velocity, second)
            first_radps, second_radps = dot(swing_radps, first), dot(swing_radps, second)
            coriolis_mps2 = first_mps * first_radps + second_mps * second_radps
            turning_radps = sqrt(first_radps * first_radps + second_radps * second_radps)
            echoes.closing_acceleration_mps2[s, b] = (
                dot(vectors.acceleration_mps2[s, b], axis) + coriolis_mps2
            )
            place = vector_at(sensor, 0)
            if surface_mps.size > 0:
                # The field moves with the surface.
                moved_m = scale(1e-9 * time_ns[s, b], vector_at(surface_mps[on_axis], 0))
                place = subtract(place, moved_m) if dot(moved_m, moved_m) < inf else place
            slides_mps, radius_m = _speckle_motion(
                beamlets, (first_mps, second_mps), (first_radps, second_radps), away_m, waist_m, rayleigh_m
            )
            to_waist = waist_m / radius_m
            drift = add(scale(to_waist * slides_mps[0], first), scale(to_waist * slides_mps[1], second))
            set_place(axis, place, drift, waist_m, echoes.speckle_place[s, b], echoes.speckle_motion[s, b])
            turned = rayleigh_m * turning_radps
            changed_m2 = first_mps * first_mps + second_mps * second_mps + turned * turned
            if changed_m2 * forgotten_s2 > waist_m * waist_m:
                echoes.speckle_place[s, b, FACE] = 0.0
            weight = footprint.weight[beam if len(footprint.weight) > 1 else 0]
            for i in range(beamlets, columns):
                echoes.closing_speed_mps[s, b, i] = echoes.power_w[s, b, i] = 0.0
                range_m[s, b, i] = echoes.range_rate_mps[s, b, i] = nan
            for i in range(beamlets):
                ray_i = on_axis + i
                range_m[s, b, i] = ranges_m[ray_i]
                facet = normals[ray_i]
                echoes.closing_speed_mps[s, b, i] = (
                    _relative_speed(surface_mps, ray_i, velocity, footprint.doppler_site[beam, i])
                    - doppler_start_m[0, beam, i] * first_radps
                    - doppler_start_m[1, beam, i] * second_radps
                )
                cos_incidence = -dot(facet, footprint.ray_site[beam, i])
                # -(n·(v + R u'))/(n·u) is the rate of the distance along the moving beam to the plane of its facet. u'
                # is the axis': a beamlet's direction and origin rotate differently by the footprint's radius times the
                # rate.
                sinking_mps = _relative_speed(surface_mps, ray_i, velocity, facet) + range_m[s, b, i] * dot(
                    facet, swing_radps
                )
                echoes.range_rate_mps[s, b, i] = sinking_mps / max(cos_incidence, LEAST_COSINE)
                lit = cos_incidence > 0.0 and range_m[s, b, i] >= 0.0
                whole_w = echo_power_w(
                    law, reflectance[ray_i], range_m[s, b, i], cos_incidence, turning_radps
                )
                echoes.power_w[s, b, i] = whole_w * weight[i] if lit else 0.0


@kernel(outermost=True)
def _follow_chirps(
    segment_s: float,
    stacked: FloatArray,
    stacked_at_chirps: FloatArray,
    range_m: FloatArray,
    normals: FloatArray,
    surface_mps: FloatArray,
    echo_arrays: tuple[Any, ...],
) -> None:
    """Set closing acceleration, closing jerk and range curvature so that closing speed and range on the axis are exact
    at the centres of all three records: parabolas through the values there, on the plane of the facet that the axis
    hits.

    Args:
        stacked, stacked_at_chirps: see `Pointing`.
        range_m, normals, surface_mps: arrays of the axes' `Hits`, (shots, beams).
    """
    echoes = Echoes(*echo_arrays)
    vectors, chirps = beam_vectors(stacked), chirp_beams(stacked_at_chirps)
    shots, beams = range_m.shape
    for s in range(shots):
        for b in range(beams):
            axis, facet, distance_m = vectors.true[s, b], normals[s, b], range_m[s, b]
            ground_mps = _surface_velocity(surface_mps, s, b)
            now_mps = dot(subtract(vectors.velocity_mps[s, b], ground_mps), axis)
            changes_mps, farther_m = (0.0, 0.0), 0.0
            for chirp in range(2):
                then = chirps.true[chirp, s, b]
                change_mps = dot(subtract(chirps.velocity_mps[chirp, s, b], ground_mps), then) - now_mps
                changes_mps = changes_mps[1], change_mps
                # From the sensor to the point that the axis hits, which moves with its facet.
                since_s = segment_s if chirp == 1 else -segment_s
                moved = subtract(vectors.sensor_m[s, b], chirps.sensor_m[chirp, s, b])
                point = add(add(moved, scale(distance_m, axis)), scale(since_s, ground_mps))
                cosine = -dot(facet, then)
                farther_m += -dot(facet, point) / cosine - distance_m if cosine > LEAST_COSINE else nan
            before_mps, after_mps = changes_mps
            echoes.closing_acceleration_mps2[s, b] = (after_mps - before_mps) / (2 * segment_s)
            echoes.closing_jerk_mps3[s, b] = (after_mps + before_mps) / (segment_s * segment_s)
            echoes.range_curvature_mps2[s, b] = nan_to_zero(farther_m / (segment_s * segment_s))


@kernel
def _surface_velocity(surface_mps: FloatArray, s: int, b: int) -> Vector:
    if surface_mps.size == 0:
        return 0.0, 0.0, 0.0
    velocity = surface_mps[s, b]
    return nan_to_zero(velocity[0]), nan_to_zero(velocity[1]), nan_to_zero(velocity[2])


@kernel
def _relative_speed(surface_mps: FloatArray, ray: int, velocity: FloatArray, along: FloatArray) -> float:
    speed_mps = dot(velocity, along)
    if surface_mps.size > 0:
        speed_mps -= nan_to_zero(dot(surface_mps[ray], along))
    return speed_mps


@kernel
def _speckle_motion(
    beamlets: int,
    across_mps: tuple[float, float],
    swing_radps: tuple[float, float],
    range_m: float,
    waist_m: float,
    rayleigh_m: float,
) -> tuple[tuple[float, float], float]:
    """Motion of the speckle within a measurement, in m/s along both axes across the beam, and the radius over which it
    changes.

    Several beamlets have their own Doppler shifts, so that the speckle only represents the exchange of scatterers: it
    moves with the footprint. With a single beamlet it represents both, and the correlations over a shift and over a
    rotation multiply, whatever their directions.
    """
    if beamlets == 1:
        slides_mps = (
            hypot(across_mps[0], rayleigh_m * swing_radps[0]),
            hypot(across_mps[1], rayleigh_m * swing_radps[1]),
        )
        return slides_mps, waist_m
    farness = range_m / rayleigh_m
    slides_mps = across_mps[0] + range_m * swing_radps[0], across_mps[1] + range_m * swing_radps[1]
    return slides_mps, waist_m * sqrt(1 + farness * farness)

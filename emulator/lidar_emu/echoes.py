"""What arrives from the footprint of each beam, at its time of validity and around it.

A beam leaves the sensor along u, which turns with u' = ω x u, while the sensor moves with v. The phase of the echo from
a fixed point of the ground, at the distance s along the axis and x across it, is 2k L with L = s + x²/(2 Rc), Rc the
radius of the beam's wavefront. Its closing speed -dL/dt is, to first order in x,

    v·u + x·(v/Rc - (1 - R/Rc) u').

Speckle: as the footprint slides by D over the ground its scatterers are exchanged, which gives the echo's field the
correlation exp(-D²/w²). The beamlets' own closing speeds make it exp(-d²/w0²) for a sensor that moved by d across the
beam and exp(-(π w0 θ/λ)²) for one that turned by θ, at any range, and the product of both for one that did both.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.flight import Flight, Pointing
from lidar_emu.fmcw.echo import coherent_power_w
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.rotations import cross, dot
from lidar_emu.scanner.footprint import Footprint, beam_radius_m, rayleigh_range_m, sample_footprint
from lidar_emu.scenario.instrument import Instrument, Optics
from lidar_emu.scenario.site import Site
from lidar_emu.scene.hits import Hits

SPECKLE_PITCH_W = pi / sqrt(8)
"""Pitch of the speckle's lattice over the beam's radius w, see `fmcw.speckle`."""

_LEAST_COSINE = 1e-3
"""A beamlet at 89.94 degrees of incidence or more slides no faster than there: it would leave its facet at once."""


def receive_light(
    instrument: Instrument, site: Site, flight: Flight, beamlets: int, pointing: Pointing, axis_hits: Hits
) -> Echoes:
    """Echoes of beams (shots, beams), each of so many beamlets, whose axes met the ground at `axis_hits`."""
    optics, wavelength_m = instrument.optics, instrument.waveform.wavelength_m
    sensor_site_m, range_m = pointing.sensor_site_m, axis_hits.range_m
    footprint = sample_footprint(
        sensor_site_m, pointing.true_site, range_m, beamlets, optics.waist_radius_m, wavelength_m
    )
    hits = _cast_beamlets(flight, footprint, axis_hits)
    cos_incidence = -dot(hits.normal_site, footprint.ray_site)
    power_w = coherent_power_w(instrument, site.surface, site.atmosphere, hits.range_m, cos_incidence)
    motion = _motion(pointing, footprint)
    rayleigh_m = rayleigh_range_m(optics.waist_radius_m, wavelength_m)
    radius_m = beam_radius_m(range_m, optics.waist_radius_m, wavelength_m)
    return Echoes(
        range_m=hits.range_m,
        closing_speed_mps=_closing_speed_mps(pointing, footprint, motion),
        power_w=np.where(np.isnan(power_w), 0.0, power_w * footprint.weight),
        range_rate_mps=_range_rate_mps(pointing, motion, hits, cos_incidence),
        closing_acceleration_mps2=motion.acceleration_mps2 + motion.coriolis_mps2,
        smear_acceleration_mps2=_smear_acceleration_mps2(motion, range_m, rayleigh_m),
        speckle_place=_speckle_place(sensor_site_m, footprint, optics),
        speckle_drift_per_s=_speckle_drift_per_s(
            motion, *_speckle_scale(beamlets, range_m, radius_m, optics, rayleigh_m)
        ),
        fired=pointing.fired,
        inside=axis_hits.inside,
    )


class _Motion(NamedTuple):
    """Of the beams, seen along their axes and across them: (shots, beams) unless the shape stands beside."""

    acceleration_mps2: FloatArray
    """a·u"""
    across_mps: tuple[FloatArray, FloatArray]
    """Components of v along the footprint's `across_site`."""
    swing_site_radps: FloatArray
    """(shots, beams, 3) u'"""
    swing_radps: tuple[FloatArray, FloatArray]
    """Its components."""
    coriolis_mps2: FloatArray
    """v·u'"""


def _motion(pointing: Pointing, footprint: Footprint) -> _Motion:
    swing_site_radps = cross(pointing.turning_site_radps, pointing.true_site)
    both = np.stack([pointing.sensor_velocity_site_mps, swing_site_radps])
    (first_mps, first_radps), (second_mps, second_radps) = (dot(both, a) for a in footprint.across_site)
    return _Motion(
        acceleration_mps2=dot(pointing.sensor_acceleration_site_mps2, pointing.true_site),
        across_mps=(first_mps, second_mps),
        swing_site_radps=swing_site_radps,
        swing_radps=(first_radps, second_radps),
        coriolis_mps2=first_mps * first_radps + second_mps * second_radps,
    )


def _cast_beamlets(flight: Flight, footprint: Footprint, axis_hits: Hits) -> Hits:
    if footprint.weight.size > 1:
        return flight.cast(footprint.start_site_m, footprint.ray_site)
    return Hits(
        axis_hits.range_m[..., None], axis_hits.normal_site[..., None, :], axis_hits.inside[..., None]
    )


def _closing_speed_mps(pointing: Pointing, footprint: Footprint, motion: _Motion) -> FloatArray:
    """Of each beamlet (shots, beams, beamlets): the sensor's velocity along the gradient of the phase, and what the
    turn of the beam adds to it."""
    speed_mps = dot(pointing.sensor_velocity_site_mps[..., None, :], footprint.doppler_site)
    for start_m, swing_radps in zip(footprint.doppler_start_m, motion.swing_radps, strict=True):
        speed_mps -= start_m * swing_radps[..., None]
    return speed_mps


def _range_rate_mps(pointing: Pointing, motion: _Motion, hits: Hits, cos_incidence: FloatArray) -> FloatArray:
    """-(n·(v + R u'))/(n·u) of each beamlet: of the distance along the moving beam to the plane of its facet.

    u' is the axis'. That of a beamlet, and the turn of its start, differ by the footprint's radius times the rate.
    """
    sinking_mps = dot(hits.normal_site, pointing.sensor_velocity_site_mps[..., None, :])
    sinking_mps += hits.range_m * dot(hits.normal_site, motion.swing_site_radps[..., None, :])
    return np.asarray(sinking_mps / np.maximum(cos_incidence, _LEAST_COSINE))


def _smear_acceleration_mps2(motion: _Motion, range_m: FloatArray, rayleigh_m: float) -> FloatArray:
    """-d²L/dt² of the point of the ground on the axis.

    a·u - v²/Rc + (1 - R/Rc) (2 v·u' + R u'²), v across the beam. Far away this is a·u - v²/R however the beam
    turns: the distance to a fixed point does not know of beams. Where the axis meets nothing only a·u is left.
    """
    squared_m2 = range_m**2 + rayleigh_m**2
    flatness = rayleigh_m**2 / squared_m2
    first_mps, second_mps = motion.across_mps
    first_radps, second_radps = motion.swing_radps
    passing_mps2 = (first_mps**2 + second_mps**2) * range_m / squared_m2
    turning_mps2 = 2 * motion.coriolis_mps2 + range_m * (first_radps**2 + second_radps**2)
    bending_mps2 = flatness * turning_mps2 - passing_mps2
    return motion.acceleration_mps2 + np.where(np.isnan(range_m), 0.0, bending_mps2)


def _speckle_place(sensor_site_m: FloatArray, footprint: Footprint, optics: Optics) -> FloatArray:
    """Where the sensor is across the beam, in pitches: from shot to shot the echo's field is that of the whole beam.

    It changes with exp(-d²/w0²). A turn of the beam changes it too, by the sensor's distance from the origin times
    the angle rather than by the Rayleigh range. Where the axis meets nothing it does not matter.
    """
    pitch_m = SPECKLE_PITCH_W * optics.waist_radius_m
    return _known(*(dot(sensor_site_m, across) / pitch_m for across in footprint.across_site))


def _speckle_scale(
    beamlets: int, range_m: FloatArray, radius_m: FloatArray, optics: Optics, rayleigh_m: float
) -> tuple[FloatArray | float, FloatArray | float]:
    """How far a turn of the beam shifts its field, and the field's radius, within a measurement.

    Several beamlets have their own Doppler shifts, and only the exchange of scatterers is left to the field; one stands
    for both.
    """
    return (rayleigh_m, optics.waist_radius_m) if beamlets == 1 else (range_m, radius_m)


def _speckle_drift_per_s(
    motion: _Motion, arm_m: FloatArray | float, radius_m: FloatArray | float
) -> FloatArray:
    """Pitches per second, v + R u' across the beam, within a measurement; 0 where the axis meets nothing."""
    pitch_m = SPECKLE_PITCH_W * radius_m
    first, second = (
        (across_mps + arm_m * swing_radps) / pitch_m
        for across_mps, swing_radps in zip(motion.across_mps, motion.swing_radps, strict=True)
    )
    return _known(first, second)


def _known(first: FloatArray, second: FloatArray) -> FloatArray:
    """Both on a last axis, 0 for NaN."""
    pair = np.stack([first, second], axis=-1)
    return np.where(np.isnan(pair), 0.0, pair)

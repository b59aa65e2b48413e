"""Spectral spread of a footprint: in range by the slope of the ground, in speed by motion across the beam."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.beams.footprint import beam_radius_m, wavefront_radius_m
from lidar_emu.beams.pointing import Pointing
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import cross, dot
from lidar_emu.receiver.received_echoes import rough_depth_m
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument
from lidar_emu.scenario.site import Site
from lidar_emu.scene.ray_hits import Hits


class Spread(NamedTuple):
    """Gradients across the beam in bins per rms radius of the footprint, (shots, beams, 3)."""

    beat: FloatArray
    doppler: FloatArray
    rough_bin: float | FloatArray = 0.0
    """(shots, beams) Standard deviation of depths on rough ground, in bins of range."""

    def variance(self, beat: float, doppler: float) -> FloatArray:
        """Variance in bins² of the frequency composed of `beat` times the beat of range and `doppler` times the Doppler
        shift."""
        gradient = beat * self.beat + doppler * self.doppler
        return np.asarray(dot(gradient, gradient) + (beat * self.rough_bin) ** 2)


def rough_bins(instrument: Instrument, site: Site, pointing: Pointing, hits: Hits) -> FloatArray:
    """Standard deviation (shots, beams) of depths of the ground's roughness, in bins of range."""
    depth_m = rough_depth_m(site.surface.roughness_m, -dot(hits.normal_site, pointing.true_site))
    return np.asarray(depth_m / instrument.waveform.range_bin_m)


def no_spread(hits: Hits) -> Spread:
    """Spread of a footprint of zero width."""
    return Spread(np.zeros_like(hits.normal_site), np.zeros_like(hits.normal_site))


def spread_bins(instrument: Instrument, pointing: Pointing, hits: Hits) -> Spread:
    """Spread of each beam, (shots, beams), over the facet that its axis hits.

    The footprint's weight exp(-4 r²/w²) has the rms radius w/√8 along any axis.

    Across the beam the gradient of range is -n/(n·u), and the gradient of closing speed v/Rc - (1 - R/Rc) u'.
    """
    waveform, waist_m = instrument.waveform, instrument.optics.waist_radius_m
    axis = pointing.true_site
    rms_m = beam_radius_m(hits.range_m, waist_m, waveform.wavelength_m)[..., None] / np.sqrt(8.0)
    curvature_m = wavefront_radius_m(hits.range_m, waist_m, waveform.wavelength_m)[..., None]
    normal, velocity = hits.normal_site, pointing.sensor_velocity_site_mps
    across = normal - dot(normal, axis)[..., None] * axis
    beat_bin_per_m = 2.0 * waveform.chirp_slope_hz_per_s / (SPEED_OF_LIGHT_MPS * waveform.bin_width_hz)
    beat = -across / dot(normal, axis)[..., None] * rms_m * beat_bin_per_m
    faster = (velocity - dot(velocity, axis)[..., None] * axis) / curvature_m
    faster -= (1.0 - hits.range_m[..., None] / curvature_m) * cross(pointing.turning_site_radps, axis)
    return Spread(beat, faster * rms_m * 2.0 / waveform.wavelength_m / waveform.bin_width_hz)

"""Scatterers scattered at random over the surface around the footprint of a beam.

The plane across the beam at the range of its axis is divided into square cells. The ray from the sensor through a
random point of each cell meets the surface at a scatterer, which represents the many grains of its patch by one
circular complex Gaussian number: fully developed speckle. A patch with the area A as seen from the sensor receives A I
of the light, with the intensity I = P 2/(π w²) exp(-2r²/w²), and returns the radiant intensity (ρ/π) f(θ) A I; a mode
receives λ² 2/(π w²) exp(-2r²/w²) of a point's radiant intensity (antenna theorem).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import dot, unit_across
from lidar_emu.reference.record_light import GaussianMode, PosesAt, Scatterers
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.site import Site
from lidar_emu.scene.ray_hits import Hits

Cast = Callable[[FloatArray], Hits]
"""Hits of rays (n, 3) from the sensor at the time of validity."""

_REACH_W = 1.75
"""Radius of the area sampled around the axis, in beam radii: 5e-6 of the power lies outside."""

_CELLS_PER_W = 8.0
"""Cells per beam radius, at least: 50 in the effective area π w²/4."""

_SPREAD_BINS = 0.6
"""Standard deviation of a line, in bins, from which on there are more cells, in proportion to the width."""

_PATH_TIMES = 13
"""Times at which the path of the footprint is computed."""

MOST_CELLS = 2_000_000
"""Cells of a footprint: a beam that turns by radians within a measurement would take all memory."""


class SurfaceSampling(NamedTuple):
    """Constants of instrument and site by which the surface is sampled."""

    mode: GaussianMode
    power_m2: float
    """SNR of a white patch at the waist, per square metre: P η λ² (2/(π w0²))² / π times the SNR per watt."""
    lommel_seeliger_share: float
    extinction_per_m: float
    range_bin_m: float
    roughness_m: float

    @classmethod
    def from_instrument(cls, instrument: Instrument, site: Site, snr_per_w: float) -> SurfaceSampling:
        """Constants for sampling the surface of a site with an instrument."""
        mode, optics, waveform = GaussianMode.of(instrument), instrument.optics, instrument.waveform
        emitted_w = optics.laser_power_w * optics.optical_efficiency * optics.depolarisation
        peak_per_m2 = 2.0 / (np.pi * mode.waist_m**2)
        air = site.atmosphere
        return cls(
            mode=mode,
            power_m2=snr_per_w * emitted_w * (waveform.wavelength_m * peak_per_m2) ** 2 / np.pi,
            lommel_seeliger_share=site.surface.lommel_seeliger_share,
            extinction_per_m=0.0 if air is None else air.extinction_per_m,
            range_bin_m=waveform.range_bin_m,
            roughness_m=site.surface.roughness_m,
        )


class FootprintPlane(NamedTuple):
    """The plane across a beam at the range of its axis, at the time of validity."""

    sensor_m: FloatArray
    """(3,)"""
    axes: FloatArray
    """(3, 3) Rows: two unit vectors in the plane, the first along the footprint's path, and the beam's axis."""
    range_m: float
    low_m: FloatArray
    """(2,) Corner of the area that the centre of the footprint crosses."""
    high_m: FloatArray


def footprint_plane(poses_at: PosesAt, from_s: float, to_s: float, range_m: float) -> FootprintPlane:
    """Find the plane across the beam, and the path of the footprint's centre in it between two times."""
    here = poses_at(np.zeros(1))
    sensor_m, axis = here.sensor_m[0], _unit(here.transmitted[0] + here.received[0])
    poses = poses_at(np.linspace(from_s, to_s, _PATH_TIMES))
    offset_m = poses.sensor_m - sensor_m
    centre_m = []
    for pointed in (poses.transmitted, poses.received):
        along_m = (range_m - offset_m @ axis) / (pointed @ axis)
        centre_m.append(offset_m + along_m[:, None] * pointed - range_m * axis)
    path_m = np.concatenate(centre_m)
    chord_m = path_m[-1] - path_m[0]
    chord_m -= (chord_m @ axis) * axis
    if np.linalg.norm(chord_m) < 1e-9:
        chord_m = unit_across(axis)
    first = _unit(chord_m)
    axes = np.stack([first, np.cross(axis, first), axis])
    place_m = path_m @ axes[:2].T
    return FootprintPlane(sensor_m, axes, range_m, place_m.min(axis=0), place_m.max(axis=0))


def sample_surface(
    sampling: SurfaceSampling, plane: FootprintPlane, line_bins: float, cast: Cast, rng: np.random.Generator
) -> tuple[Scatterers, FloatArray]:
    """Scatter points over the surface that a beam meets.

    Args:
        line_bins: standard deviation of the line by motion, in bins.

    Returns:
        The scatterers, perhaps none, and the ranges of all rays, NaN where one meets nothing.

    Raises:
        InputError: the footprint has more than `MOST_CELLS`.
    """
    radius_m = float(sampling.mode.radius_m(plane.range_m))
    reach_m = _REACH_W * radius_m
    pitch_m = radius_m / _CELLS_PER_W
    probes = _cells(plane.low_m - 0.5 * reach_m, plane.high_m + 0.5 * reach_m, 4 * pitch_m)
    probe_m = cast(_rays(plane, probes)).range_m
    slope_bins = float(np.nanstd(probe_m)) / sampling.range_bin_m if np.isfinite(probe_m).any() else 0.0
    pitch_m /= max(1.0, float(np.hypot(slope_bins, line_bins)) / _SPREAD_BINS) ** 0.5
    corner_m = _cells(plane.low_m - reach_m, plane.high_m + reach_m, pitch_m)
    rays = _rays(plane, corner_m + pitch_m * rng.random(corner_m.shape))
    hits = cast(rays)
    cos_incidence = -np.asarray(dot(hits.normal_site, rays))
    lit = (hits.range_m > 0.0) & (cos_incidence > 0.0) & (hits.reflectance * sampling.power_m2 > 0.0)
    range_m, cosine = hits.range_m[lit], cos_incidence[lit]
    if sampling.roughness_m > 0.0:
        range_m = range_m + sampling.roughness_m / np.maximum(cosine, 1e-3) * rng.standard_normal(
            len(range_m)
        )
    share = sampling.lommel_seeliger_share
    area_m2 = np.square(pitch_m * range_m / plane.range_m)
    power = sampling.power_m2 * area_m2 * hits.reflectance[lit] * (share + (1.0 - share) * cosine)
    power *= np.exp(-2.0 * sampling.extinction_per_m * range_m)
    number = rng.standard_normal((len(rays), 2))[lit] @ np.array([1.0, 1j])
    velocity_mps = hits.velocity_site_mps[lit] if hits.moving else np.zeros((len(range_m), 3))
    scatterers = Scatterers(
        plane.sensor_m + range_m[:, None] * rays[lit], velocity_mps, np.sqrt(0.5 * power) * number
    )
    return scatterers, hits.range_m


def _cells(low_m: FloatArray, high_m: FloatArray, pitch_m: float) -> FloatArray:
    cells = float(np.prod((high_m - low_m) / pitch_m))
    if cells > MOST_CELLS:
        found = Finding(f"{cells:.2g} scatterers in a footprint")
        raise InputError("level", "reference", found, f"take spectral: at most {MOST_CELLS:.0e} are computed")
    east_m, north_m = (np.arange(low, high, pitch_m) for low, high in zip(low_m, high_m, strict=True))
    return np.stack(np.meshgrid(east_m, north_m), axis=-1).reshape(-1, 2)


def _rays(plane: FootprintPlane, place_m: FloatArray) -> FloatArray:
    """Unit vectors (n, 3) from the sensor to points (n, 2) of the plane."""
    rays = place_m @ plane.axes[:2] + plane.range_m * plane.axes[2]
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))

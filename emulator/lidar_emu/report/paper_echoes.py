"""The beam of a flight whose echo is shared most evenly by two targets, and its spectrum computed from samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.fmcw.receiver_constants import build_receiver
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.fmcw.waveform.level import measure_one_beam
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.scanner.state import ScannerState
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import BLOCK_SHOTS

_LEAST_APART_BINS = 8.0
"""Least separation of two targets that the spectrum resolves."""
_LEAST_SHARE = 0.05
_CONSTANT, _DOWN = 1, 2


@dataclass(frozen=True)
class TwoTargets:
    """Spectrum of a beam with two targets at different ranges; powers are relative to the mean noise of a bin."""

    shot: int
    beam: int
    true_range_m: tuple[float, float]
    """Range of the nearest and of the farthest beamlet."""
    doppler_bin: float
    """Signed Doppler shift from the constant segment: offset between a chirp's peak and its range."""
    range_bin_m: float
    power: FloatArray
    """(N/2 + 1,) Windowed power of the down-chirp's bins."""
    threshold: float
    group_power: float
    """Least power of a bin that belongs to a target."""
    peak_bin: IntArray
    """(targets,) strongest first."""

    @property
    def range_m(self) -> FloatArray:
        """(targets,) Ranges of the peaks."""
        return np.asarray(self.peak_bin - self.doppler_bin) * self.range_bin_m


def find_two_targets(model: FlightModel) -> TwoTargets:
    """Find the beam of a flight whose footprint is shared most evenly by two targets, and compute its spectrum.

    Raises:
        InputError: no beam of the flight has two targets.
    """
    scenario = model.scenario
    receiver = build_receiver(scenario.instrument, scenario.site, scenario.left_out_share)
    number, beam, before = _most_shared(model, _LEAST_APART_BINS * receiver.range_bin_m)
    shot = np.arange(number, number + 1, dtype=np.int64)
    echoes, _ = _echoes(model, shot, before)
    received = measure_one_beam(scenario.instrument, receiver, echoes, shot, scenario.seed, 0, beam)
    assert received.bins is not None
    power = np.abs(received.bins[0, _DOWN]) ** 2 / received.noise_power
    peak = received.targets[_DOWN].peak_bin[0]
    range_m = echoes.range_m[0, beam]
    return TwoTargets(
        shot=number,
        beam=beam,
        true_range_m=(float(range_m.min()), float(range_m.max())),
        doppler_bin=float(
            np.copysign(received.targets[_CONSTANT].peak_bin[0, 0], received.closing_speed_mps[0])
        ),
        range_bin_m=receiver.range_bin_m,
        power=power,
        threshold=receiver.threshold,
        group_power=float(scenario.instrument.detection.group_fraction**2 * power[1:-1].max()),
        peak_bin=peak[np.isfinite(peak)].astype(np.int64),
    )


def _most_shared(model: FlightModel, least_apart_m: float) -> tuple[int, int, ScannerState]:
    """Find shot and beam of the most evenly shared footprint; also return the scanner's state before the shot."""
    state, best, found = model.initial_state, _LEAST_SHARE, None
    for first in range(0, model.shot_count, BLOCK_SHOTS):
        before = state
        shot = np.arange(first, min(first + BLOCK_SHOTS, model.shot_count), dtype=np.int64)
        echoes, state = _echoes(model, shot, before)
        share = lesser_share(echoes.range_m, echoes.power_w, least_apart_m)
        if share.max() > best:
            after, beam = divmod(int(share.argmax()), model.beam_count)
            best, found = share.max(), (first, after, beam, before)
    if found is None:
        nothing = Finding("a flight without a beam on two targets")
        raise InputError(model.scenario.name, None, nothing, "must be a flight over trees, boulders or edges")
    first, after, beam, before = found
    return first + after, beam, model.state_after(first, after, before) if after else before


def _echoes(model: FlightModel, shot: NDArray[np.int64], state: ScannerState) -> tuple[Echoes, ScannerState]:
    """Compute echoes, which are valid until the next call, and the scanner's state after them."""
    pointing, after = model.aim(shot, state)
    return model.echo_model.echoes(pointing, model.flight.cast(pointing)), after


def lesser_share(range_m: FloatArray, power_w: FloatArray, least_apart_m: float) -> FloatArray:
    """(...) Share of the power of beamlets (..., beamlets) from the weaker side of the widest gap in range.

    It is 0 where the gap is narrower than `least_apart_m`, or there is no power.
    """
    order = np.argsort(range_m, axis=-1)
    sorted_m, sorted_w = (np.take_along_axis(array, order, axis=-1) for array in (range_m, power_w))
    ahead_m = np.nan_to_num(np.diff(sorted_m, axis=-1, prepend=sorted_m[..., :1]), nan=0.0)
    first_far = ahead_m.argmax(axis=-1)[..., None]
    sorted_w = np.nan_to_num(sorted_w, nan=0.0)
    total_w = sorted_w.sum(axis=-1)
    before_w = np.cumsum(sorted_w, axis=-1) - sorted_w
    near = np.take_along_axis(before_w, first_far, axis=-1)[..., 0] / np.where(total_w > 0, total_w, np.inf)
    return np.where(ahead_m.max(axis=-1) > least_apart_m, np.minimum(near, 1.0 - near), 0.0)

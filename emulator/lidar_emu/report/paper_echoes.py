"""The beam of a flight whose light is most evenly shared between two things, and its spectrum sample by sample."""

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
"""Between two targets that the spectrum keeps apart."""
_LEAST_SHARE = 0.05
_CONSTANT, _DOWN = 1, 2


@dataclass(frozen=True)
class TwoTargets:
    """One record of a beam that meets two things one behind the other; powers are over the mean noise of a bin."""

    shot: int
    beam: int
    true_range_m: tuple[float, float]
    """Of the beamlet that ends nearest, and of the one that ends farthest."""
    doppler_bin: float
    """Where the constant segment has its line, signed: what lies between a line of the chirp and its range."""
    range_bin_m: float
    power: FloatArray
    """(N/2 + 1,) of the down-chirp's bins under the window of detection."""
    threshold: float
    group_power: float
    """What a bin has to exceed to belong to a target."""
    peak_bin: IntArray
    """(targets,) strongest first."""

    @property
    def range_m(self) -> FloatArray:
        """(targets,) of the peaks."""
        return np.asarray(self.peak_bin - self.doppler_bin) * self.range_bin_m


def find_two_targets(model: FlightModel) -> TwoTargets:
    """Look through a flight for the beam whose footprint is shared most evenly, and listen to it.

    Raises:
        InputError: no beam of the flight meets two things.
    """
    scenario = model.scenario
    receiver = build_receiver(scenario.instrument, scenario.site, scenario.exact)
    number, beam, before = _most_shared(model, _LEAST_APART_BINS * receiver.range_bin_m)
    shot = np.arange(number, number + 1, dtype=np.int64)
    echoes, _ = _echoes(model, shot, before)
    heard = measure_one_beam(scenario.instrument, receiver, echoes, shot, scenario.seed, 0, beam)
    assert heard.bins is not None
    power = np.abs(heard.bins[0, _DOWN]) ** 2 / heard.noise_power
    peak = heard.targets[_DOWN].peak_bin[0]
    range_m = echoes.range_m[0, beam]
    return TwoTargets(
        shot=number,
        beam=beam,
        true_range_m=(float(range_m.min()), float(range_m.max())),
        doppler_bin=float(np.copysign(heard.targets[_CONSTANT].peak_bin[0, 0], heard.closing_speed_mps[0])),
        range_bin_m=receiver.range_bin_m,
        power=power,
        threshold=float(-scenario.instrument.log_false_alarm_per_bin),
        group_power=float(scenario.instrument.detection.group_fraction**2 * power[1:-1].max()),
        peak_bin=peak[np.isfinite(peak)].astype(np.int64),
    )


def _most_shared(model: FlightModel, least_apart_m: float) -> tuple[int, int, ScannerState]:
    """The shot and the beam, and the scanner's state before that shot."""
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
        nothing = Finding("a flight of which no beam meets two things")
        raise InputError(model.scenario.name, None, nothing, "allowed: one over trees, boulders or edges")
    first, after, beam, before = found
    return first + after, beam, model.state_after(first, after, before) if after else before


def _echoes(model: FlightModel, shot: NDArray[np.int64], state: ScannerState) -> tuple[Echoes, ScannerState]:
    """They hold until the next echoes."""
    pointing, after = model.aim(shot, state)
    return model.echo_model.echoes(pointing, model.flight.cast(pointing)), after


def lesser_share(range_m: FloatArray, power_w: FloatArray, least_apart_m: float) -> FloatArray:
    """Share (...) of the light of beamlets (..., beamlets) that comes from the lesser side of the widest gap in range.

    0 where there is no gap as wide as that, or no light.
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

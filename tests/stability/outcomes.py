"""What the receiver makes of beams, checked against what must hold of anything that it reports, and against truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from beat_truth import BeatTruth, beat_truth, beyond

from lidar_emu.bench.stability import violations
from lidar_emu.measurement import Measurement
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import Echoes, Reason, Returns
from lidar_emu.scenario.instrument import Instrument

Beams = tuple[Instrument, Echoes]

FORTY_DIGITS = "beats in 40 digits"
ANYWHERE = (np.inf, np.inf)


class Outcome(NamedTuple):
    """Outcome of all beams of an extreme; errors are the largest over valid beams whose sign is resolved."""

    reasons: frozenset[Reason]
    resolved: bool
    """Every valid beam's sign."""
    range_m: float
    speed_mps: float
    tone_bin: float
    """Of every segment of such beams; NaN where tones are not compared."""
    excess_m: float
    """Largest part of a range's error that six of its own standard deviations do not cover."""
    excess_mps: float


@dataclass(frozen=True)
class Extreme:
    """One row of the table."""

    name: str
    reasons: frozenset[Reason]
    """Those that may occur."""
    measure: Callable[[], Outcome]
    against: str = FORTY_DIGITS
    resolved: bool = True
    """Every valid beam must have its sign resolved."""
    beside: tuple[float, float] = (2e-4, 2e-6)
    """Allowed, in m and m/s, beside six standard deviations: sigma includes noise alone."""

    @property
    def must_be_valid(self) -> str:
        """Whether each beam must be valid, in a word."""
        if self.reasons == {Reason.VALID}:
            return "yes"
        return "may" if Reason.VALID in self.reasons else "must not"


def check_report(report: Returns | Measurement, maximum_range_m: float) -> None:
    """What holds whatever comes in, as the bench checks it."""
    assert list(violations(report, maximum_range_m)) == []


def measure_beams(runs: Iterable[Beams], seed: int = 1) -> Outcome:
    """Outcome of beams whose beamlets bound the truth."""
    outcomes = []
    for instrument, echoes in runs:
        returns = receive(build_receiver(instrument), echoes, np.arange(len(echoes.fired)), seed)
        check_report(returns, instrument.detection.maximum_range_m)
        outcomes.append(_outcome(instrument, echoes, returns))
    return joined(outcomes)


def joined(outcomes: list[Outcome]) -> Outcome:
    """The worst of several."""
    columns = list(zip(*outcomes, strict=True))
    worst = [float(np.max(column)) for column in columns[2:]]
    return Outcome(frozenset().union(*columns[0]), all(columns[1]), *worst)


def compare(
    report: Returns | Measurement, truth: BeatTruth, rows: np.ndarray, tones: np.ndarray, cycle_mps: float
) -> Outcome:
    """Outcome of a report whose flat `rows` are compared with the truth of just these.

    Args:
        tones: (rows, 3) errors in bins.
        cycle_mps: λ fs/2, by which closing speeds cannot be distinguished.
    """
    valid = report.range_valid.ravel()
    range_error = beyond(report.range_m.ravel()[rows], truth.range_m)
    speed_mps = report.closing_speed_mps.ravel()[rows]
    speed_error = np.min([beyond(speed_mps + k * cycle_mps, truth.speed_mps) for k in (-1, 0, 1)], axis=0)
    return Outcome(
        frozenset(Reason(int(code)) for code in np.unique(report.reason)),
        bool(report.sign_resolved.ravel()[valid].all()),
        float(np.max(range_error, initial=0.0)),
        float(np.max(speed_error, initial=0.0)),
        float(np.nanmax(tones, initial=0.0)),
        float(np.max(range_error - 6 * report.sigma_range_m.ravel()[rows], initial=-np.inf)),
        float(np.max(speed_error - 6 * report.sigma_speed_mps.ravel()[rows], initial=-np.inf)),
    )


def _outcome(instrument: Instrument, echoes: Echoes, returns: Returns) -> Outcome:
    waveform = instrument.waveform
    rows = np.flatnonzero(returns.range_valid & returns.sign_resolved)
    truth = _bounds(instrument, echoes, rows)
    observed_bin = returns.segment_peak_hz.reshape(-1, 3)[rows] / waveform.bin_width_hz
    tones = np.maximum(truth.observed_bin[:, 0] - observed_bin, observed_bin - truth.observed_bin[:, 1])
    return compare(returns, truth, rows, tones, waveform.wavelength_m * waveform.sample_rate_hz / 2)


def _bounds(instrument: Instrument, echoes: Echoes, rows: np.ndarray) -> BeatTruth:
    """Bounds over the beamlets of each of the flat `rows`; bounds of the tones are (rows, 2, 3)."""
    tones, ranges, speeds = np.zeros((len(rows), 2, 3)), np.zeros((len(rows), 2)), np.zeros((len(rows), 2))
    flat = [
        np.broadcast_to(column, echoes.range_m.shape).reshape(-1, echoes.range_m.shape[2])
        for column in (
            echoes.range_m,
            echoes.closing_speed_mps,
            echoes.range_rate_mps,
            echoes.closing_acceleration_mps2[..., None],
        )
    ]
    for i, row in enumerate(rows):
        beamlets = np.unique([column[row] for column in flat], axis=1)
        truth = beat_truth(instrument.waveform, *beamlets)
        tones[i] = truth.observed_bin.min(axis=0), truth.observed_bin.max(axis=0)
        ranges[i] = truth.range_m.min(), truth.range_m.max()
        speeds[i] = truth.speed_mps.min(), truth.speed_mps.max()
    return BeatTruth(tones, ranges, speeds)

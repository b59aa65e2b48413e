"""Range and speed from the targets of three spectra, by exhaustive search: for level reference and custom detectors."""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import interpreted, with_fields
from lidar_emu.receiver.range_speed_estimation import ALL
from lidar_emu.receiver.records import TARGET
from lidar_emu.receiver.residual_limit import ResidualLimit, close_residual_bin, largest_residual_bin
from lidar_emu.receiver.returns import Reason, Returns
from lidar_emu.receiver.stated_variance import VarianceLaw, build_variance_law, inconsistency, state_variances
from lidar_emu.receiver.target_pairs import PEDESTAL_CHANCE, TALLEST_M
from lidar_emu.receiver.whole_spectrum import TARGETS, Targets, window_gain, window_noise_power
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Detection, Waveform

_REFUTED = 9.0
"""Three standard deviations, squared: cost of a fold at N/2, and additional cost at which an alternative is rejected.
"""

_APART = 36.0
"""Six standard deviations, squared: closer explanations count as equal."""

_SLACK = 3.0
"""Standard deviations by which the beat of range may lie outside the possible range."""

_DESIGN = np.array([[1.0, -1.0], [0.0, 1.0], [1.0, 1.0]])
"""Design matrix: signed beats of up-chirp, constant segment and down-chirp from range and Doppler shift."""

_CONSTRAINT = np.array([-1.0, -2.0, 1.0])
"""The combination of signed beats that is 0, orthogonal to the design."""


class Combined(NamedTuple):
    """Estimates (records,); NaN where no choice of signs and folds is possible."""

    range_bin: FloatArray
    doppler_bin: FloatArray
    range_variance: FloatArray
    doppler_variance: FloatArray
    residual_bin: FloatArray
    """Residual g₋ - g₊ - 2 g₀ with the chosen signs."""
    residual_variance: FloatArray
    sign_resolved: BoolArray
    """Whether no other explanation fits as well."""
    folds: FloatArray
    """Chirps whose beat is folded at N/2."""


def chirp_minus_doppler(
    observed: FloatArray, variance: FloatArray, length: int, farthest_bin: float
) -> Combined:
    """The published detector (Budge et al.): the higher chirp less the Doppler line; folds at N/2 are ignored.

    The lower chirp may have passed zero: in the residual it has the sign that fits better. The sign counts as resolved
    where the chirps differ by three standard deviations, the residual is within three standard deviations (and a bin),
    and there is no rival (`_explanations`).

    Args:
        observed: (records, 3) frequencies of up-chirp, constant segment, down-chirp.
        variance: variances of the frequencies.
        length: N.
        farthest_bin: largest possible beat of range.
    """
    up, constant, down = np.moveaxis(observed, -1, 0)
    up_variance, constant_variance, down_variance = np.moveaxis(variance, -1, 0)
    receding = up > down
    doppler = np.where(receding, -constant, constant)
    longer, shorter = np.where(receding, up, down), np.where(receding, down, up)
    excess = longer - 2.0 * constant
    shorter = np.where(abs(excess - shorter) <= abs(excess + shorter), shorter, -shorter)
    signed = np.stack(
        [np.where(receding, longer, shorter), doppler, np.where(receding, shorter, longer)], axis=-1
    )
    residual = signed @ _CONSTRAINT
    differ = np.square(up - down) > _REFUTED * (up_variance + down_variance)
    spread = variance @ np.square(_CONSTRAINT)
    # Motion and the chirps' optical frequencies separate the segments' Doppler shifts by a fraction of a bin.
    consistent = np.abs(residual) <= np.sqrt(_REFUTED * spread) + 1.0
    rivalled = _explanations(observed, variance, length, farthest_bin).rival_of(signed)
    return Combined(
        longer - constant,
        doppler,
        np.where(receding, up_variance, down_variance) + constant_variance,
        constant_variance,
        residual,
        spread,
        differ & consistent & ~rivalled,
        np.zeros(len(observed)),
    )


class _Explanations(NamedTuple):
    """All choices of signs and folds, (records, choices), by weighted least squares."""

    signed: FloatArray
    """(records, choices, 3)"""
    beat: FloatArray
    doppler: FloatArray
    misfit: FloatArray
    """Squared residual in standard deviations; infinite where the beat of range is impossible."""
    folds: FloatArray
    """(choices,) Number of folds."""
    range_variance: FloatArray
    """(records,)"""
    doppler_variance: FloatArray
    spread: FloatArray
    """(records,) Variance of the residual."""
    nearest_alias: FloatArray
    """(records,) Smallest beat b whose alias N - b is possible; with the opposite Doppler shift it has the same
    frequencies."""

    solver: FloatArray
    """(records, 2, 3) Beat of range and Doppler shift from signed beats."""

    def rival_of(self, signed: FloatArray) -> BoolArray:
        """Whether an explanation more than six standard deviations away from the one with these signed beats
        (records, 3), in range or Doppler shift, has a misfit that is larger by no more than 9, or 9 times its own;
        folds do not count, (records,)."""
        beat, doppler = np.einsum("rbs,rs->br", self.solver, signed)
        misfit = np.square(signed @ _CONSTRAINT) / self.spread
        apart = np.square(self.beat - beat[:, None]) > _APART * self.range_variance[:, None]
        apart |= np.square(self.doppler - doppler[:, None]) > _APART * self.doppler_variance[:, None]
        limit = misfit + _REFUTED * np.maximum(1.0, misfit)
        near = np.isfinite(self.misfit) & (self.misfit <= limit[:, None])
        return np.asarray((apart & near).any(axis=1) | (beat >= self.nearest_alias))


def _explanations(
    observed: FloatArray, variance: FloatArray, length: int, farthest_bin: float
) -> _Explanations:
    """Explanations of frequencies (records, 3).

    A chirp is one of F, -F, N - F, F - N, and N + F where beats beyond N/2 are possible; the constant segment F or -F.
    """
    weighted = _DESIGN[None] / variance[..., None]
    covariance = np.linalg.inv(np.swapaxes(weighted, 1, 2) @ _DESIGN)
    solver = covariance @ np.swapaxes(weighted, 1, 2)
    range_variance, doppler_variance = covariance[:, 0, 0], covariance[:, 1, 1]
    slack = _SLACK * np.sqrt(range_variance)
    spread = variance @ np.square(_CONSTRAINT)

    # Sign, multiple of N and folds: (choices, 3, 3), then (records, choices).
    chirp = [(1, 0, 0), (-1, 0, 0), (-1, 1, 1), (1, -1, 1)]
    if farthest_bin > length / 2:
        chirp.append((1, 1, 2))
    choices = np.array(
        [(up, constant, down) for constant, up, down in product(chirp[:2], chirp, chirp)], float
    )
    signed = choices[:, :, 0] * observed[:, None] + choices[:, :, 1] * length
    # Summed explicitly: a library's sum may round mirrored choices differently, and equal costs would no longer be
    # equal.
    residual = signed[..., 2] - signed[..., 0] - 2.0 * signed[..., 1]
    misfit = np.square(residual) / spread[:, None]
    beat, doppler = np.moveaxis(np.einsum("rbs,rcs->rcb", solver, signed), -1, 0)
    misfit[(beat < -slack[:, None]) | (beat > farthest_bin + slack[:, None])] = np.inf
    folds = choices[:, :, 2].sum(axis=1)
    alias = length - (farthest_bin + slack)
    return _Explanations(
        signed, beat, doppler, misfit, folds, range_variance, doppler_variance, spread, alias, solver
    )


def least_squares(observed: FloatArray, variance: FloatArray, length: int, farthest_bin: float) -> Combined:
    """Weighted least squares with the signs and folds of least residual.

    The cost of an explanation is the squared residual in standard deviations, plus 9 for each fold at N/2, and the beat
    of range must lie from 0 to `farthest_bin`, to three standard deviations. At equal cost a closing constant segment
    takes precedence, then the first up-chirp and the first down-chirp in the order F, -F, N - F, F - N, N + F. The sign
    is resolved where there is no rival.

    Args:
        observed, variance: (records, 3).
        length: N.
        farthest_bin: largest possible beat of range.
    """
    every = _explanations(observed, variance, length, farthest_bin)
    cost = every.misfit + _REFUTED * every.folds
    row, best = np.arange(len(observed)), np.argmin(cost, axis=1)
    found = np.isfinite(cost[row, best])
    signed = np.where(found[:, None], every.signed[row, best], np.nan)
    beat, doppler = (np.where(found, values[row, best], np.nan) for values in (every.beat, every.doppler))
    return Combined(
        beat,
        doppler,
        every.range_variance,
        every.doppler_variance,
        signed @ _CONSTRAINT,
        every.spread,
        found & ~every.rival_of(signed),
        every.folds[best],
    )


def to_beam_result(
    waveform: Waveform,
    detection: Detection,
    targets: tuple[Targets, Targets, Targets],
    windowed_level: FloatArray,
    residual_limit: ResidualLimit | None = None,
) -> Returns:
    """Ranges and closing speed (records,) from the targets of each segment, or the reason why there are none.

    Args:
        waveform, detection: parts of the instrument; slope and frequency are the nominal ones.
        targets: targets of up-chirp, constant segment and down-chirp.
        windowed_level: mean noise power of a windowed bin, one for all or (N/2 + 1,).
        residual_limit: limit of the residual; None: none.
    """
    law = build_variance_law(waveform, detection)
    vibration_bin2 = 0.0 if residual_limit is None else residual_limit.vibration_bin2
    explain = partial(_explained, waveform, detection, law, vibration_bin2, targets)
    detected = np.stack([~np.isnan(target.frequency_bin[:, 0]) for target in targets])
    everywhere, records = np.asarray(detected.all(axis=0)), detected.shape[1]
    numbers = np.where(everywhere[:, None], 0, -1) * np.ones(3, dtype=int)
    best, second = (np.full((len(Combined._fields), records), np.nan) for _ in range(2))
    returns, speckle_bin2 = np.zeros(records, dtype=np.uint8), np.zeros((records, 2, 2))
    several = np.zeros(records, dtype=np.bool_)
    for row in np.flatnonzero(everywhere).tolist():
        alone, _ = explain(row, np.zeros((1, 3), dtype=np.int64))
        kept = [_outside_pedestal(waveform, detection, each, row, alone.range_bin[0]) for each in targets]
        several[row] = max(len(kept[0]), len(kept[2])) > 1
        triples = np.array(list(product(*kept)))
        combined, shown_bin2 = explain(row, triples)
        accepted = _surfaces(waveform, detection, residual_limit, targets, row, triples, combined)
        returns[row] = len(accepted)
        strongest = accepted[0] if accepted else 0
        numbers[row] = triples[strongest]
        best[:, row] = [values[strongest] for values in combined]
        speckle_bin2[row, : len(accepted[:2])] = shown_bin2[accepted[:2]]
        if len(accepted) > 1:
            second[:, row] = [values[accepted[1]] for values in combined]
    first, other = Combined(*best), Combined(*second)
    range_m, second_m = (each.range_bin * waveform.range_bin_m for each in (first, other))
    reason = np.full(records, Reason.BELOW_THRESHOLD, dtype=np.int8)
    reason[everywhere] = Reason.VALID
    refuted = (returns == 0) & (detection.combine != "chirp_minus_doppler")
    reason[everywhere & (refuted | ~(range_m >= 0.0))] = Reason.AMBIGUOUS
    reason[(reason == Reason.VALID) & (range_m > detection.maximum_range_m)] = Reason.BEYOND_RANGE
    valid = reason == Reason.VALID
    returns[valid] = np.maximum(returns[valid], 1)
    second_reason = np.where(several, Reason.AMBIGUOUS, Reason.BELOW_THRESHOLD)
    second_reason[returns > 1] = Reason.VALID
    second_reason[second_m > detection.maximum_range_m] = Reason.BEYOND_RANGE
    both = second_reason == Reason.VALID
    speed_bin_mps = waveform.speed_bin_mps
    peaks, snr_db = _peaks(waveform, detection, targets, np.maximum(numbers, 0), windowed_level)
    return Returns.with_columns(
        (records,),
        range_m=np.where(valid, range_m, np.nan),
        closing_speed_mps=np.where(valid, first.doppler_bin * speed_bin_mps, np.nan),
        range_valid=valid,
        speed_valid=valid,
        reason=reason,
        sign_resolved=valid & (first.sign_resolved == 1.0),
        segments=np.packbits(detected, axis=0, bitorder="little")[0],
        snr_db=snr_db,
        residual_mps=0.5 * first.residual_bin * speed_bin_mps,
        sigma_range_m=np.where(valid, np.sqrt(first.range_variance) * waveform.range_bin_m, np.nan),
        sigma_speed_mps=np.where(valid, np.sqrt(first.doppler_variance) * speed_bin_mps, np.nan),
        returns=returns,
        second_range_m=np.where(both, second_m, np.nan),
        second_sigma_range_m=np.where(both, np.sqrt(other.range_variance) * waveform.range_bin_m, np.nan),
        second_reason=second_reason.astype(np.int8),
        segment_peak_hz=peaks * waveform.bin_width_hz,
        speckle_bin2=speckle_bin2,
    )


def unseen(range_m: FloatArray, edge_m: float) -> Reason:
    """Reason why nothing was detected."""
    if np.isnan(range_m).all():
        return Reason.NO_SURFACE
    return Reason.BELOW_THRESHOLD if np.nanmin(range_m) <= edge_m else Reason.BEYOND_RANGE


def nothing(reason: Reason) -> Returns:
    """Report of a beam that is not measured."""
    why = np.array([reason], dtype=np.int8)
    return Returns.with_columns((1,), reason=why, second_reason=why)


def _outside_pedestal(
    waveform: Waveform, detection: Detection, targets: Targets, row: int, range_bin: float
) -> list[int]:
    """Numbers of the targets of one record that the laser's phase noise does not explain, the strongest first."""
    found = np.flatnonzero(np.isfinite(targets.frequency_bin[row]))
    delay_s = 2.0 * range_bin * waveform.range_bin_m / SPEED_OF_LIGHT_MPS
    if not delay_s > 0.0 or waveform.linewidth_hz == 0.0:
        return [*found]
    apart_hz = (targets.frequency_bin[row, found] - targets.frequency_bin[row, 0]) * waveform.bin_width_hz
    # Spectral density of the phase drift, 2π Δν τ² sinc²(fτ), over the white noise's bandwidth of a bin, relative to
    # what is left of the line.
    drift = 2.0 * np.pi * waveform.linewidth_hz * delay_s
    density_per_hz = drift * np.exp(drift) * delay_s
    bandwidth_hz = (
        window_noise_power(detection.window, waveform.fft_length)
        / window_gain(detection.window) ** 2
        * waveform.bin_width_hz
    )
    bins = 2.0 / (delay_s * waveform.bin_width_hz)
    share = density_per_hz * bandwidth_hz / np.maximum(1.0, np.square(np.pi * delay_s * apart_hz))
    limit = targets.power[row, 0] * share * np.log(bins / PEDESTAL_CHANCE)
    above = targets.power[row, found] >= limit
    above[0] = True
    return [*found[above]]


def _explained(
    waveform: Waveform,
    detection: Detection,
    law: VarianceLaw,
    vibration_bin2: float,
    targets: tuple[Targets, Targets, Targets],
    row: int,
    triples: NDArray[np.int64],
) -> tuple[Combined, FloatArray]:
    """Estimates (n,) from triples (n, 3) of targets of one record, and rows (n, 2) of `Returns.speckle_bin2`."""
    observed = _of_triples(targets, "frequency_bin", row, triples)
    variance, speckle = _stated_variances(law, targets, row, triples)
    farthest_bin = waveform.record_edge_range_m / waveform.range_bin_m
    combine = {"chirp_minus_doppler": chirp_minus_doppler, "least_squares": least_squares}[detection.combine]
    every = combine(observed, variance, waveform.fft_length, farthest_bin)
    every = every._replace(residual_variance=every.residual_variance + vibration_bin2)
    residuals = zip(every.residual_bin, every.residual_variance, strict=True)
    factor = np.array([interpreted(inconsistency)(*residual) for residual in residuals])
    return every._replace(
        range_variance=every.range_variance * factor,
        doppler_variance=every.doppler_variance * factor + speckle[:, 0],
    ), np.stack([speckle[:, 1] * factor, speckle[:, 2]], axis=-1)


def _surfaces(
    waveform: Waveform,
    detection: Detection,
    residual_limit: ResidualLimit | None,
    targets: tuple[Targets, Targets, Targets],
    row: int,
    triples: NDArray[np.int64],
    combined: Combined,
) -> list[int]:
    """Numbers of the triples that are accepted (`target_pairs`), strongest first."""
    published = detection.combine == "chirp_minus_doppler"
    frequency = _of_triples(targets, "frequency_bin", row, triples)
    power = _of_triples(targets, "power", row, triples)
    width = _of_triples(targets, "width_bin2", row, triples)
    receding = frequency[:, 0] > frequency[:, 2]
    strength = power[:, 0] + power[:, 2]
    chirps = [[(0, up), (2, down)] for up, _, down in triples]
    if published:
        strength = np.where(receding, power[:, 0], power[:, 2])
        chirps = [[pair[0] if back else pair[1]] for pair, back in zip(chirps, receding, strict=True)]
    largest = np.full(len(triples), np.inf)
    if residual_limit is not None:
        limit = np.vectorize(partial(interpreted(largest_residual_bin), residual_limit), otypes=[float])
        values = combined.range_bin, combined.doppler_bin, combined.residual_variance, width.max(axis=1)
        largest = limit(*values)
        close = np.vectorize(interpreted(close_residual_bin), otypes=[float])
        agree = close(combined.residual_variance[:1])
        largest[1:] = np.minimum(largest, close(combined.residual_variance))[1:]
    if published and triples[:, 1].max() == 0:
        largest = np.maximum(largest, TALLEST_M / waveform.range_bin_m)
    misfit = np.abs(combined.residual_bin)
    possible = (combined.range_bin >= 0.0) & (misfit <= largest)
    possible[1:] &= combined.folds[1:] == 0
    used: set[tuple[int, int]] = set()
    accepted: list[int] = []
    order = np.argsort(misfit, kind="stable")
    if residual_limit is None or misfit[0] <= agree[0]:
        order = np.concatenate([[0], order])
    for number in order:
        along = not (published and accepted) or receding[number] == receding[accepted[0]]
        if possible[number] and along and used.isdisjoint(chirps[number]) and len(accepted) < TARGETS:
            accepted.append(int(number))
            used.update(chirps[number])
    return sorted(accepted, key=lambda number: -strength[number])


def _stated_variances(
    law: VarianceLaw, targets: tuple[Targets, Targets, Targets], row: int, triples: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    variance, speckle = np.full((len(triples), 3), np.nan), np.full((len(triples), 3), np.nan)
    for number, triple in enumerate(triples):
        three = np.zeros(3, dtype=TARGET)
        for name in Targets._fields[:5]:  # all but power and number of the highest bin
            three[name] = [getattr(target, name)[row, triple[s]] for s, target in enumerate(targets)]
        speckle[number] = state_variances(law, ALL, with_fields(three))
        variance[number] = three["variance_bin2"]
    return variance, speckle


def _of_triples(
    targets: tuple[Targets, Targets, Targets],
    name: Literal["frequency_bin", "width_bin2", "power", "peak_bin"],
    row: int | NDArray[np.int64],
    triples: NDArray[np.int64],
) -> FloatArray:
    """A value of the targets with these numbers (n, 3) of one record, or of as many, (n, 3)."""
    return np.stack([getattr(each, name)[row, triples[:, s]] for s, each in enumerate(targets)], axis=-1)


def _peaks(
    waveform: Waveform,
    detection: Detection,
    targets: tuple[Targets, Targets, Targets],
    numbers: NDArray[np.int64],
    windowed_level: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Beats (records, 3) in bins of the targets with these numbers (records, 3), and the mean of their SNRs over the
    segments with a detection, referred to a rectangular bin before the window."""
    rows = np.arange(len(numbers))
    place = _of_triples(targets, "peak_bin", rows, numbers)
    detected = np.isfinite(place)
    level = np.broadcast_to(windowed_level, waveform.fft_length // 2 + 1)
    here = level[np.where(detected, place, 0.0).astype(int)]
    over = np.where(detected, _of_triples(targets, "power", rows, numbers) / here, 0.0)
    count = detected.sum(axis=1)
    mean = np.where(count > 0, over.sum(axis=1) / np.maximum(count, 1), np.nan)
    window = detection.window
    rectangular = window_noise_power(window, waveform.fft_length) / window_gain(window) ** 2
    return _of_triples(targets, "frequency_bin", rows, numbers), np.asarray(
        10.0 * np.log10(rectangular * mean)
    )

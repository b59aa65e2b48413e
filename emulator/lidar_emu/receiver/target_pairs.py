"""Which targets of the three spectra belong to one surface.

A footprint may lie on two surfaces, such as the top and the foot of a boulder, and each segment sees both, one of them
or none, since each has speckle of its own. All triples of an up-chirp's, a constant segment's and a down-chirp's target
are candidates. The strongest of each are accepted if they agree closely, then those with the least residuals
g₋ - g₊ - 2 g₀, as long as each chirp's target is used once; surfaces that do not move share a Doppler line. Of those
accepted the strongest is the measurement, the next one the second return.

With four targets in each spectrum there are 64 triples of 32 explanations each, of which chance makes some fit. All but
the strongest targets therefore must agree to three standard deviations and a bin and a half, without folds at N/2.

The published detector subtracts the Doppler line from the targets of the longer chirp, and looks at the other chirp for
the direction alone. Where there is one Doppler line, a target of the longer chirp needs no partner within `TALLEST_M`;
where there are several, the residual decides which one belongs to it.

The phase noise of the laser surrounds a strong line with a pedestal, 1/delay wide, whose peaks are no surfaces. Targets
that it explains are left out before.
"""

from __future__ import annotations

from math import exp, inf, log, pi
from typing import Any

from numpy.typing import NDArray

from lidar_emu.numerics.arrays import IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.receiver.laser_phase_noise import phase_drift
from lidar_emu.receiver.range_speed_estimation import (
    ALL,
    CHIRP_MINUS_DOPPLER,
    estimate_range_speed,
    with_opposite_sign,
)
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import MAX_TARGETS, Candidate
from lidar_emu.receiver.residual_limit import close_residual_bin, largest_residual_bin
from lidar_emu.receiver.stated_variance import inconsistency, state_variances

TALLEST_M = 50.0
"""Height of a step up to which two targets of one chirp are taken for surfaces of the same speed."""

PEDESTAL_CHANCE = 1e-3
"""Probability that a pedestal has a peak that counts as a target."""

_FREE, _ACCEPTED, _EXCLUDED = range(3)
"""States of a candidate."""


@kernel
def pair_targets(
    model: ReceiverModel,
    counts: IntArray,
    targets: NDArray[Any],
    triple: NDArray[Any],
    candidates: NDArray[Any],
) -> int:
    """Find the surfaces that all three segments see.

    Args:
        model: constants of the receiver.
        counts: (3,) number of targets of each segment, all above 0; without those in a pedestal on return.
        targets: (3, MAX_TARGETS) of TARGET, strongest first, likewise.
        triple: (3,) of TARGET, overwritten.
        candidates: (MAX_TARGETS³,) of CANDIDATE, overwritten; the first one is of the strongest targets.

    Returns:
        Number of surfaces, in `candidates` those for `take_strongest`.
    """
    strongest = candidates[0]
    strongest.up = strongest.constant = strongest.down = 0
    explain(model, ALL, targets, triple, strongest)
    if strongest.range_bin > 0.0 and max(counts) > 1:
        _leave_out_pedestals(model, counts, targets, strongest.range_bin * model.range_bin_m)
    total = 0
    for i in range(counts[0]):
        for k in range(counts[1]):
            for j in range(counts[2]):
                candidate = candidates[total]
                candidate.up, candidate.constant, candidate.down = i, k, j
                if total > 0:
                    explain(model, ALL, targets, triple, candidate)
                if model.combine_method == CHIRP_MINUS_DOPPLER and counts[1] == 1:
                    candidate.limit_bin = max(candidate.limit_bin, TALLEST_M / model.range_bin_m)
                total += 1
    accepted = 0
    while accepted < MAX_TARGETS:
        best = _least_residual(candidates[:total])
        if best < 0:
            break
        _exclude_others(model, candidates[:total], candidates[best])
        candidates[best].state = _ACCEPTED
        accepted += 1
    return accepted


@kernel
def _leave_out_pedestals(
    model: ReceiverModel, counts: IntArray, targets: NDArray[Any], range_m: float
) -> None:
    """Leave out targets that the pedestal of the strongest one explains.

    Of a line's power, its pedestal has at most the share x τ sinc²(kτ) in bin k, and its centre exp(-x), with the
    variance x of the laser's phase drift within the delay τ in records. The pedestal's 2/τ bins are exponential.
    Averaged looks exceed the limit less often.
    """
    delay = model.delay_per_m * range_m
    drift = phase_drift(model, range_m)
    if drift == 0.0:
        return
    noise_bandwidth_bin = model.noise_power / model.window.centre**2
    least = log(2.0 / (PEDESTAL_CHANCE * delay)) * noise_bandwidth_bin * drift * exp(drift) * delay
    for segment in range(3):
        strongest, kept = targets[segment, 0], 1
        for t in range(1, counts[segment]):
            target = targets[segment, t]
            angle = pi * delay * (target.frequency_bin - strongest.frequency_bin)
            if target.power >= strongest.power * least / max(1.0, angle * angle):
                targets[segment, kept] = target
                kept += 1
        counts[segment] = kept


@kernel
def explain(
    model: ReceiverModel, mask: int, targets: NDArray[Any], triple: NDArray[Any], candidate: Candidate
) -> None:
    """Set a candidate's estimate from its targets.

    Args:
        model: constants of the receiver.
        mask: bits of the segments that have a target.
        targets: (3, MAX_TARGETS) of TARGET.
        triple: (3,) of TARGET, overwritten by the candidate's targets with their variances as stated.
        candidate: record of CANDIDATE, of which the numbers of the targets are set.
    """
    triple[0] = targets[0, candidate.up]
    triple[1] = targets[1, candidate.constant]
    triple[2] = targets[2, candidate.down]
    speckle = state_variances(model.variance_law, mask, triple)
    farthest_bin = model.record_edge_range_m / model.range_bin_m
    estimate = estimate_range_speed(model.combine_method, mask, triple, model.fft_length, farthest_bin)
    if model.opposite_doppler_sign:
        estimate = with_opposite_sign(estimate, mask, triple)
    residual_variance = estimate.residual_variance + model.residual_limit.vibration_bin2
    factor = inconsistency(estimate.residual_bin, residual_variance)
    strongest = candidate.up + candidate.constant + candidate.down == 0
    possible = estimate.found and estimate.range_bin >= 0.0 and (strongest or estimate.folds == 0)
    candidate.state = _FREE if possible else _EXCLUDED
    candidate.range_bin, candidate.doppler_bin = estimate.range_bin, estimate.doppler_bin
    candidate.range_variance = factor * estimate.range_variance
    candidate.doppler_variance = factor * estimate.doppler_variance + speckle.doppler_bin2
    candidate.speckle_bin2[0] = factor * speckle.range_bin2
    candidate.speckle_bin2[1] = speckle.quadrature_bin2
    candidate.residual_bin, candidate.sign_resolved = estimate.residual_bin, estimate.sign_resolved
    # The lower chirp only tells the direction to the published detector.
    candidate.receding = triple[0].frequency_bin > triple[2].frequency_bin
    candidate.power = triple[0].power + triple[2].power
    if model.combine_method == CHIRP_MINUS_DOPPLER:
        candidate.power = triple[0].power if candidate.receding else triple[2].power
    widest = max(triple[0].width_bin2, triple[1].width_bin2, triple[2].width_bin2)
    candidate.limit_bin = largest_residual_bin(
        model.residual_limit, estimate.range_bin, estimate.doppler_bin, residual_variance, widest
    )
    candidate.close_bin = close_residual_bin(residual_variance)
    if not strongest:
        candidate.limit_bin = min(candidate.limit_bin, candidate.close_bin)


@kernel
def _least_residual(candidates: NDArray[Any]) -> int:
    # Beside a strong line, its pedestal may fit better by chance.
    if candidates[0].state == _FREE and abs(candidates[0].residual_bin) <= candidates[0].close_bin:
        return 0
    best, least_bin = -1, inf
    for c in range(len(candidates)):
        candidate = candidates[c]
        residual_bin = abs(candidate.residual_bin)
        # Without a residual there is nothing to refute.
        possible = candidate.state == _FREE and not residual_bin > candidate.limit_bin
        if possible and (best < 0 or residual_bin < least_bin):
            best, least_bin = c, residual_bin
    return best


@kernel
def _exclude_others(model: ReceiverModel, candidates: NDArray[Any], accepted: Candidate) -> None:
    """Exclude what uses the targets of a chirp again, of either chirp or of the longer one alone."""
    for c in range(len(candidates)):
        candidate = candidates[c]
        if candidate.state != _FREE:
            continue
        used = candidate.up == accepted.up or candidate.down == accepted.down
        if model.combine_method == CHIRP_MINUS_DOPPLER:
            used = candidate.up == accepted.up if accepted.receding else candidate.down == accepted.down
            used |= candidate.receding != accepted.receding
        if used:
            candidate.state = _EXCLUDED


@kernel
def take_strongest(counts: IntArray, candidates: NDArray[Any]) -> int:
    """Index of the strongest accepted candidate that was not taken yet; there must be one. Arguments as above."""
    best = -1
    for c in range(counts[0] * counts[1] * counts[2]):
        if candidates[c].state == _ACCEPTED and (best < 0 or candidates[c].power > candidates[best].power):
            best = c
    candidates[best].state = _EXCLUDED
    return best

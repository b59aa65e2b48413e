"""The grade of a navigation: errors of its solutions against the truth at their own times, and what it trusted.

A value of a beam *deceives* if the instrument reports it as valid and it is wrong: farther from the truth than ten of
the sigmas that the instrument states and than `DECEIVING_M` or `DECEIVING_MPS`. Deceiving values of a beam that are
less than `JOINED_S` apart are one deception, whatever caused it: a fault, an edge of the ground, dust, speckle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.trial.solutions import REJECTED, Solutions, Trust

DECEIVING_SIGMAS, DECEIVING_M, DECEIVING_MPS, JOINED_S = 10.0, 1.0, 0.1, 1.0
STALE_S = 0.5
"""Age of the last solution from which on a navigation counts as unavailable."""


class TrueMotion(NamedTuple):
    """Motion of the body frame's origin at instants (n,); NaN before the first shot and after the last."""

    position_site_m: FloatArray
    """(n, 3)"""
    velocity_site_mps: FloatArray
    """(n, 3)"""
    altitude_m: FloatArray
    """(n,) Height above the ground straight below; NaN where there is none."""


class Deception(NamedTuple):
    """A beam that deceived from its first wrong value to its last, and what the navigation did about it."""

    quantity: str
    """`range` or `speed`."""
    beam: int
    from_s: float
    until_s: float
    distrust_s: float
    """From the first wrong value to the first wrong one that is not used; inf: all are; NaN: no solution
    judges one of them."""
    recovery_s: float
    """From the last wrong value to the first solution that uses a right one; inf: none, or the beam was never
    distrusted; NaN: no right value follows."""


class Series(NamedTuple):
    """Values of a quantity, and the true altitude of each."""

    value: FloatArray
    altitude_m: FloatArray


class Grade(NamedTuple):
    """The grade of a navigation on one flight."""

    stated: Solutions
    truth: TrueMotion
    """At the solutions' times of validity."""
    flight_s: FloatArray
    """(shots,) Times of the shots."""
    flight: TrueMotion
    """At the shots."""
    deceptions: list[Deception]
    series: dict[str, Series]
    """A value per solution or deception, by the quantities of `SERIES`."""
    figures: dict[str, float]
    """A value per flight, by the quantities of `FIGURES`; NaN where nothing is known."""
    commanded_m: dict[str, float]
    """True altitude at which a command was accepted first, by its name."""

    def errors(self, kind: str) -> tuple[FloatArray, FloatArray]:
        """Errors of `altitude` or `velocity`, and their stated sigmas, (solutions, components)."""
        stated, truth = self.stated, self.truth
        if kind == "altitude":
            return (stated.altitude_m - truth.altitude_m)[:, None], stated.sigma_altitude_m[:, None]
        return stated.velocity_site_mps - truth.velocity_site_mps, stated.sigma_velocity_mps


SERIES = {
    "altitude_error_m_abs": "Error of the altitude",
    "position_error_m_abs": "Error of the position, as a distance",
    "velocity_error_mps_abs": "Error of the velocity, as the magnitude of the vector",
    "vertical_speed_error_mps_abs": "Error of the vertical velocity",
    "altitude_error_sigmas_abs": "Error of the altitude over its stated sigma",
    "position_nees": "Squared error of the position over its stated variances: chi-square of 3 degrees",
    "velocity_nees": "Squared error of the velocity over its stated variances: chi-square of 3 degrees",
    "latency_s": "From the time of validity to the solution's arrival",
    "distrust_s": "From the first value of a deception to the first of them that is not used",
    "recovery_s": "From the last value of a deception to the solution that uses the beam again",
}
COMMANDED = "commanded_altitude_m"
FIGURES = {
    COMMANDED: "True altitude at which the command that the requirement names was accepted first",
    "solutions": "Number of solutions",
    "available_share": f"Share of the flight with a solution that is at most {STALE_S:g} s old",
    "longest_gap_s": "Longest time without a solution",
    "altitude_within_1_sigma": "Share of altitudes within one stated sigma: 0.683 if it is Gaussian and right",
    "altitude_within_3_sigma": "Share of altitudes within three stated sigmas: 0.997",
    "velocity_within_1_sigma": "Share of velocity components within one stated sigma: 0.683",
    "velocity_within_3_sigma": "Share of velocity components within three stated sigmas: 0.997",
    "velocity_nees_mean": "Mean of `velocity_nees`: 3",
    "false_distrust_share": "Share of the values that are right and that the navigation rejects",
    "deceived_share": "Share of the deceiving values that the navigation uses",
    "deceived_altitude_error_m": "Largest error of the altitude during deceptions and a second after",
    "deceived_velocity_error_mps": "Largest error of the velocity during deceptions and a second after",
    "touchdown_speed_mps": "True speed at the end of the flight",
    "touchdown_vertical_speed_mps": "True vertical speed at the end of the flight, downward",
    "touchdown_distance_m": "True horizontal distance from the site's origin at the end of the flight",
    "touchdown_altitude_m": "True altitude at the end of the flight: it has landed only if this is small",
}


HeightAbove = Callable[[FloatArray, FloatArray], FloatArray]
"""Height of the ground at east and north, (n,) each."""


def true_motion(flown: Measurement, height_m: HeightAbove, time_s: FloatArray) -> TrueMotion:
    """True motion at instants (n,), by cubics through position, velocity and acceleration of the shots."""
    from scipy.interpolate import CubicHermiteSpline

    at_s = flown.time_ns[:, 0] * 1e-9
    motion = (flown.position_site_m, flown.velocity_site_mps, flown.acceleration_site_mps2)
    position_m, velocity_mps = (
        np.asarray(CubicHermiteSpline(at_s, value, rate, extrapolate=False)(time_s))
        for value, rate in (motion[:2], motion[1:])
    )
    altitude_m = np.full(len(time_s), np.nan)
    inside = np.isfinite(position_m[:, 0])
    east_m, north_m, up_m = position_m[inside].T
    altitude_m[inside] = up_m - height_m(east_m, north_m)
    return TrueMotion(position_m, velocity_mps, altitude_m)


def grade(
    flown: Measurement, height_m: HeightAbove, stated: Solutions, commanded_s: Mapping[str, float]
) -> Grade:
    """Grade the solutions that a navigation stated during a flight.

    Args:
        flown: the measurement that it was sent, with its ground truth.
        height_m: height of the ground.
        stated: its solutions; those before the first shot and after the last have no error.
        commanded_s: when each command was accepted first, scenario time, by its name.
    """
    values = _values_of_beams(flown, stated)
    deceptions = [found for value in values for found in value.deceptions()]
    flight_s = (flown.time_ns[:, 0] * 1e-9).astype(np.float64)
    instants_s = (
        stated.time_s, flight_s, [each.from_s for each in deceptions], list(commanded_s.values())
    )  # fmt: skip
    motion = true_motion(flown, height_m, np.concatenate(instants_s))
    ends = np.cumsum([len(each) for each in instants_s])[:-1]
    columns = [np.split(column, ends) for column in motion]
    truth, flight, onset, commanded = (TrueMotion(*parts) for parts in zip(*columns, strict=True))
    series = {name: Series(value, truth.altitude_m) for name, value in _errors(stated, truth).items()}
    for name in ("distrust_s", "recovery_s"):
        series[name] = Series(np.array([getattr(each, name) for each in deceptions]), onset.altitude_m)
    figures = (
        _availability(flown, stated)
        | _consistency(stated, truth, series)
        | _trust(values)
        | _deceived_errors(stated, series, deceptions)
        | _touchdown(flown, height_m)
    )
    commanded_m = dict(zip(commanded_s, commanded.altitude_m.tolist(), strict=True))
    return Grade(stated, truth, flight_s, flight, deceptions, series, figures, commanded_m)


def _errors(stated: Solutions, truth: TrueMotion) -> dict[str, FloatArray]:
    altitude_m = stated.altitude_m - truth.altitude_m
    position_m = stated.position_site_m - truth.position_site_m
    velocity_mps = stated.velocity_site_mps - truth.velocity_site_mps
    return {
        "altitude_error_m_abs": np.abs(altitude_m),
        "position_error_m_abs": np.linalg.norm(position_m, axis=1),
        "velocity_error_mps_abs": np.linalg.norm(velocity_mps, axis=1),
        "vertical_speed_error_mps_abs": np.abs(velocity_mps[:, 2]),
        "altitude_error_sigmas_abs": np.abs(altitude_m) / _positive(stated.sigma_altitude_m),
        "position_nees": np.sum(np.square(position_m / _positive(stated.sigma_position_m)), axis=1),
        "velocity_nees": np.sum(np.square(velocity_mps / _positive(stated.sigma_velocity_mps)), axis=1),
        "latency_s": stated.arrived_s - stated.time_s,
    }


def _positive(sigma: FloatArray) -> FloatArray:
    """Sigmas; NaN for those that state nothing."""
    return np.where(sigma > 0, sigma, np.nan)


def _availability(flown: Measurement, stated: Solutions) -> dict[str, float]:
    first_s, last_s = flown.time_ns.min() * 1e-9, flown.time_ns.max() * 1e-9
    gaps_s = np.diff(arrivals_s(stated, first_s, last_s))
    # Before the first solution none is available, however short that time is.
    stale_s = gaps_s[0] + np.maximum(gaps_s[1:] - STALE_S, 0.0).sum()
    return {
        "solutions": float(len(gaps_s) - 1),
        "available_share": float(1.0 - stale_s / max(last_s - first_s, 1e-9)),
        "longest_gap_s": float(gaps_s.max()),
    }


def arrivals_s(stated: Solutions, first_s: float, last_s: float) -> FloatArray:
    """Times at which the vehicle could use the solutions that came during a flight, between its begin and its end."""
    is_usable = np.isfinite(stated.altitude_m) | np.isfinite(stated.velocity_site_mps).all(axis=1)
    at_s = np.fmax(stated.arrived_s, stated.time_s)[is_usable]
    return np.concatenate([[first_s], np.sort(at_s[(at_s >= first_s) & (at_s <= last_s)]), [last_s]])


def _consistency(stated: Solutions, truth: TrueMotion, series: dict[str, Series]) -> dict[str, float]:
    altitude, nees = (series[name].value for name in ("altitude_error_sigmas_abs", "velocity_nees"))
    velocity = (stated.velocity_site_mps - truth.velocity_site_mps) / _positive(stated.sigma_velocity_mps)
    shares = {
        f"{name}_within_{sigmas}_sigma": _mean(np.abs(error[np.isfinite(error)]) <= sigmas)
        for name, error in (("altitude", altitude), ("velocity", velocity))
        for sigmas in (1, 3)
    }
    return shares | {"velocity_nees_mean": _mean(nees[np.isfinite(nees)])}


def _mean(values: NDArray[np.generic]) -> float:
    return float(values.mean()) if values.size else np.nan


class _BeamValues(NamedTuple):
    """Ranges or speeds of a beam shot by shot, and the solutions that state what was done with them."""

    quantity: str
    beam: int
    at_s: FloatArray
    """(shots,)"""
    right: BoolArray
    """(shots,) Reported as valid, and right."""
    wrong: BoolArray
    """(shots,) Reported as valid, and wrong."""
    shot: IntArray
    """(m,) Last shot at the time of validity of each solution that judges the beam."""
    solved_s: FloatArray
    """(m,) Time of validity of these."""
    trust: IntArray
    """(m,) Codes of `Trust`."""

    def deceptions(self) -> Iterator[Deception]:
        """The deceptions of this beam, in the order of time."""
        wrong = np.flatnonzero(self.wrong)
        for part in np.split(wrong, np.flatnonzero(np.diff(self.at_s[wrong]) > JOINED_S) + 1):
            if part.size:
                from_s, until_s = float(self.at_s[part[0]]), float(self.at_s[part[-1]])
                distrust, recovery = self._judged(part)
                yield Deception(self.quantity, self.beam, from_s, until_s, distrust, recovery)

    def _judged(self, part: IntArray) -> tuple[float, float]:
        """Seconds until distrust and recovery, of a deception in these shots."""
        used = self.trust == Trust.USED
        # A shot between without a value, or with a right one, says nothing about distrust.
        judged = np.flatnonzero(np.isin(self.shot, part))
        if not judged.size:
            return np.nan, np.nan
        unused = judged[~used[judged]]
        if not unused.size:
            return np.inf, np.inf
        distrust = float(self.solved_s[unused[0]] - self.at_s[part[0]])
        after = (self.shot > part[-1]) & self.right[self.shot]
        if not after.any():
            return distrust, np.nan
        again_s = self.solved_s[after & used]
        return distrust, float(again_s.min() - self.at_s[part[-1]]) if again_s.size else np.inf


def _values_of_beams(flown: Measurement, stated: Solutions) -> list[_BeamValues]:
    at_s = (flown.time_ns * 1e-9).astype(np.float64)
    period_s = float(np.median(np.diff(at_s[:, 0])))
    # A solution uses the last shot that was complete by its time; clocks count in microseconds or coarser.
    shot = np.searchsorted(at_s.max(axis=1), stated.time_s + 0.1 * period_s, side="right") - 1
    found = []
    for quantity, trust, valid, off, sigma, least in (
        ("range", stated.range_trust, flown.range_valid, flown.range_m - flown.true_range_m, flown.sigma_range_m,
         DECEIVING_M),
        ("speed", stated.speed_trust, flown.speed_valid, flown.closing_speed_mps - flown.true_closing_speed_mps,
         flown.sigma_speed_mps, DECEIVING_MPS),
    ):  # fmt: skip
        # Where the beam hits nothing, a value is wrong whatever it is.
        near = np.abs(off) <= np.maximum(DECEIVING_SIGMAS * np.nan_to_num(sigma), least)
        for beam in range(flown.beam_count):
            codes = trust[:, beam] if beam < trust.shape[1] else np.zeros(len(stated.time_s), dtype=np.int8)
            states = (shot >= 0) & (codes != Trust.NOT_JUDGED)
            right, wrong = valid[:, beam] & near[:, beam], valid[:, beam] & ~near[:, beam]
            found.append(
                _BeamValues(
                    quantity,
                    beam,
                    at_s[:, beam],
                    right,
                    wrong,
                    shot[states],
                    stated.time_s[states],
                    codes[states].astype(np.int64),
                )
            )
    return found


def _trust(values: list[_BeamValues]) -> dict[str, float]:
    rejected = [np.isin(each.trust[each.right[each.shot]], REJECTED) for each in values]
    used = [each.trust[each.wrong[each.shot]] == Trust.USED for each in values]
    return {
        "false_distrust_share": _mean(np.concatenate(rejected)),
        "deceived_share": _mean(np.concatenate(used)),
    }


def _deceived_errors(
    stated: Solutions, series: dict[str, Series], deceptions: list[Deception]
) -> dict[str, float]:
    during = np.zeros(len(stated.time_s), dtype=np.bool_)
    for each in deceptions:
        during |= (stated.time_s >= each.from_s) & (stated.time_s <= each.until_s + JOINED_S)
    pairs = (
        ("deceived_altitude_error_m", "altitude_error_m_abs"),
        ("deceived_velocity_error_mps", "velocity_error_mps_abs"),
    )
    errors = {name: series[of].value[during] for name, of in pairs}
    return {
        name: float(np.nanmax(error)) if np.isfinite(error).any() else np.nan
        for name, error in errors.items()
    }


def _touchdown(flown: Measurement, height_m: HeightAbove) -> dict[str, float]:
    velocity_mps, position_m = flown.velocity_site_mps[-1], flown.position_site_m[-1]
    east_m, north_m, up_m = position_m[:, None]
    return {
        "touchdown_speed_mps": float(np.linalg.norm(velocity_mps)),
        "touchdown_vertical_speed_mps": float(-velocity_mps[2]),
        "touchdown_distance_m": float(np.hypot(*position_m[:2])),
        "touchdown_altitude_m": float((up_m - height_m(east_m, north_m))[0]),
    }

"""Acceptance of measurements: the beams' actual noise, outliers, and divergence of the filter."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from beams import Array
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Rules:
    """Rules by which a navigator accepts measurements."""

    gate: float = 10.83
    """A beam is an outlier if its squared innovation over its variance is larger: one good beam in a thousand."""
    scales_sigma: bool = True
    """Whether standard deviations are scaled by the noise that parity shows; otherwise the packets' values are used
    unchanged."""
    reinitialise_after: int | None = 20
    """Number of consecutive shots with fewer than two accepted beams, though the beams agree with each other, after
    which the estimate has diverged and is reinitialised from the beams; None: never."""


CAREFUL = Rules()
STUBBORN = Rules(scales_sigma=False, reinitialise_after=None)
"""Uses a gate, but never reinitialises."""
CREDULOUS = Rules(gate=np.inf, scales_sigma=False, reinitialise_after=None)
"""Accepts every measurement that is flagged valid."""
BLIND = Rules(gate=0.0, reinitialise_after=None)
"""Accepts nothing: the inertial unit alone."""
NAMED = {"careful": CAREFUL, "stubborn": STUBBORN, "credulous": CREDULOUS, "blind": BLIND}

WINDOW = 40
"""Shots over which noise is estimated: two seconds."""
SIGNIFICANT_FACTOR = 3.0
"""Variance factors up to this one may be chance: with correct sigmas, about one window in a thousand exceeds it."""


class NoiseMonitor:
    """Estimates the noise and detects divergence, for the ranges or for the speeds."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._squares: deque[float] = deque(maxlen=WINDOW)
        self._shots = self._rejected = 0

    def add(self, parity: Array) -> None:
        """Add the parity of a shot; empty without redundant beams."""
        self._shots += 1
        if len(parity):
            # Wilson and Hilferty (1931): the median of chi-square by its degrees of freedom.
            middle = len(parity) * (1 - 2 / (9 * len(parity))) ** 3
            self._squares.append(float(parity @ parity) / middle)

    @property
    def is_ready(self) -> bool:
        """Whether there are enough shots to estimate the noise."""
        return not self._rules.scales_sigma or 2 * self._shots >= WINDOW

    @property
    def variance_factor(self) -> float:
        """Ratio of the actual variances to the stated ones. The median is insensitive to outliers, which the gate
        rejects; persistent noise is not an outlier."""
        if not (self._rules.scales_sigma and self._squares):
            return 1.0
        factor = float(np.median(self._squares))
        return factor if factor > SIGNIFICANT_FACTOR else 1.0

    def inliers(self, innovation: Array, variance: Array) -> BoolArray:
        """(beams,) Whether to accept each beam; NaN is rejected."""
        within: BoolArray = innovation**2 <= self._rules.gate * variance
        return within

    def detects_divergence(self, accepted: int, parity: Array) -> bool:
        """Count a shot by its number of accepted beams; return whether to reinitialise the estimate. Shots without
        parity do not count."""
        if len(parity):
            agree = bool(np.all(parity**2 <= self._rules.gate * self.variance_factor))
            self._rejected = self._rejected + 1 if agree and accepted < 2 else 0
        if self._rules.reinitialise_after is None or self._rejected < self._rules.reinitialise_after:
            return False
        self._rejected = 0
        return True

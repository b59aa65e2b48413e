"""Whom to believe: how noisy the beams really are, which of them are outliers, and when the filter itself is lost."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from beams import Array
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Rules:
    """How careful a navigator is."""

    gate: float = 10.83
    """A beam is an outlier if its innovation squared, over its variance, is more: one good beam in a thousand."""
    weighs: bool = True
    """Whether standard deviations grow with the noise that parity shows; if not, the packets' are believed."""
    lost_after: int | None = 20
    """After so many shots in a row from which fewer than two beams were taken, though they agree with each other, it is
    the estimate that is wrong, and begins again from the beams; None: never."""


CAREFUL = Rules()
STUBBORN = Rules(weighs=False, lost_after=None)
"""Has a gate, and never doubts itself."""
CREDULOUS = Rules(gate=np.inf, weighs=False, lost_after=None)
"""Takes whatever is flagged valid."""
BLIND = Rules(gate=0.0, lost_after=None)
"""Takes nothing: the inertial unit alone."""
NAMED = {"careful": CAREFUL, "stubborn": STUBBORN, "credulous": CREDULOUS, "blind": BLIND}

WINDOW = 40
"""Shots over which noise is judged: two seconds."""
NOTICEABLE = 3.0
"""Less than so many times the variance may be chance: of windows of honest beams one in a thousand or so shows more."""


class Watch:
    """Over the ranges, or over the speeds."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._squares: deque[float] = deque(maxlen=WINDOW)
        self._seen = self._refused = 0

    def listen(self, parity: Array) -> None:
        """What a shot's beams say against each other; nothing where there was no beam to spare."""
        self._seen += 1
        if len(parity):
            # Wilson and Hilferty (1931): the median of chi-square by its degrees of freedom.
            middle = len(parity) * (1 - 2 / (9 * len(parity))) ** 3
            self._squares.append(float(parity @ parity) / middle)

    @property
    def is_settled(self) -> bool:
        """Whether enough was heard to judge the noise."""
        return not self._rules.weighs or 2 * self._seen >= WINDOW

    @property
    def variance_factor(self) -> float:
        """By how much variances are more than stated. The median stands up to outliers, which are the gate's business;
        noise that stays is no outlier."""
        if not (self._rules.weighs and self._squares):
            return 1.0
        factor = float(np.median(self._squares))
        return factor if factor > NOTICEABLE else 1.0

    def inliers(self, innovation: Array, variance: Array) -> BoolArray:
        """Which beams to take; NaN is none."""
        within: BoolArray = innovation**2 <= self._rules.gate * variance
        return within

    def finds_lost(self, taken: int, parity: Array) -> bool:
        """Count a shot of which so many beams were taken; whether the estimate is to begin again. Beams that cannot
        contradict each other count for nothing."""
        if len(parity):
            agree = bool(np.all(parity**2 <= self._rules.gate * self.variance_factor))
            self._refused = self._refused + 1 if agree and taken < 2 else 0
        if self._rules.lost_after is None or self._refused < self._rules.lost_after:
            return False
        self._refused = 0
        return True

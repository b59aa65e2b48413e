"""A campaign: many runs of one scenario, some of its keys drawn at random (Monte Carlo dispersions)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from lidar_emu.errors import Finding
from lidar_emu.scenario.section import Part, Positive, unusable

_Matrix = list[list[float]]


class Uniform(Part):
    """Uniform distribution between two bounds."""

    kind: Literal["uniform"]
    low: float
    """Least value."""
    high: float
    """Largest value."""

    def _check(self) -> None:
        _check_ascending(self.low, self.high)


class Integer(Part):
    """Uniform distribution of whole numbers between two bounds, both included, as for seeds and counts."""

    kind: Literal["integer"]
    low: Annotated[int, Field(ge=-(2**52), le=2**52)]
    """Least value."""
    high: Annotated[int, Field(ge=-(2**52), le=2**52)]
    """Largest value."""

    def _check(self) -> None:
        _check_ascending(self.low, self.high)


class Normal(Part):
    """Normal distribution, truncated where bounds are given."""

    kind: Literal["normal"]
    mean: float
    """Before truncation."""
    sigma: Positive
    """Standard deviation, before truncation."""
    low: float | None = None
    """Lower bound. Left out: none."""
    high: float | None = None
    """Upper bound. Left out: none."""

    def _check(self) -> None:
        if self.low is not None and self.high is not None:
            _check_ascending(self.low, self.high)


class Lognormal(Part):
    """Lognormal distribution, for factors: doubling is as likely as halving."""

    kind: Literal["lognormal"]
    median: Positive
    """Median of the values."""
    sigma_log: Positive
    """Standard deviation of the natural logarithm; if small, about the relative standard deviation."""


class Triangular(Part):
    """Triangular distribution, from its least, likeliest and largest value."""

    kind: Literal["triangular"]
    low: float
    """Least value."""
    mode: float
    """Likeliest value."""
    high: float
    """Largest value."""

    def _check(self) -> None:
        if not self.low <= self.mode <= self.high:
            raise unusable("mode", self.mode, f"from {self.low:g} to {self.high:g}")
        _check_ascending(self.low, self.high)


class Choice(Part):
    """Random choice from a list of values: numbers, text, names of parts, or whole mappings."""

    kind: Literal["choice"]
    of: Annotated[list[Any], Field(min_length=1, max_length=10_000)]
    """The values."""
    weights: list[Annotated[float, Field(ge=0)]] = []
    """Relative probability of each value, in any unit. Left out: all equal."""

    def _check(self) -> None:
        if self.weights and (len(self.weights) != len(self.of) or sum(self.weights) <= 0):
            raise unusable("weights", self.weights, f"{len(self.of)} numbers, not all of them 0, or none")


Distribution = Annotated[
    Uniform | Integer | Normal | Lognormal | Triangular | Choice, Field(discriminator="kind")
]


class JointNormal(Part):
    """Multivariate normal distribution of several keys, such as the errors that a navigation filter states."""

    keys: Annotated[list[str], Field(min_length=1)]
    """Dotted keys of the scenario."""
    mean: list[float]
    """Mean of each key."""
    covariance: _Matrix
    """Covariance matrix, one row per key, in the units of the keys: symmetric and positive definite."""

    def _check(self) -> None:
        if len(self.mean) != len(self.keys):
            raise unusable("mean", self.mean, "one number per key")
        _check_square(self.covariance, "covariance", len(self.keys))


class Correlation(Part):
    """Correlation of keys in `dispersions` by a Gaussian copula; for normal distributions, their correlation
    coefficients."""

    keys: Annotated[list[str], Field(min_length=2)]
    """Keys of `dispersions`."""
    matrix: _Matrix
    """Correlation matrix, one row per key, ones on the diagonal: symmetric and positive definite."""

    def _check(self) -> None:
        _check_square(self.matrix, "matrix", len(self.keys))
        for i, row in enumerate(self.matrix):
            if row[i] != 1.0:
                raise unusable(f"matrix.{i}.{i}", row[i], "1 on the diagonal")


class Campaign(Part):
    """A Monte Carlo campaign: a separate file, which names the scenario that is flown."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    """Shown in plans and figures."""
    scenario: str
    """A scenario's file, relative to this one, or the name of a shipped scenario."""
    set: dict[str, Any] = {}
    """Dotted keys of the scenario and the values that all runs have instead of its own."""
    runs: Annotated[int, Field(ge=1, le=10_000_000)]
    """Number of runs."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Seed of the dispersed keys and of the runs' own seeds."""
    sampling: Literal["random", "latin_hypercube", "sobol", "saltelli"] = "random"
    """`random`: each run is drawn independently; `latin_hypercube` and `sobol`: spread evenly over all runs;
    `saltelli`: for Sobol indices, as with `--sensitivity`."""
    dispersions: dict[str, Distribution] = {}
    """Dotted keys of the scenario, each with its distribution."""
    joint_normals: list[JointNormal] = []
    """Keys that are drawn jointly."""
    correlations: list[Correlation] = []
    """Correlations between dispersions."""
    beams_every: Annotated[int, Field(ge=1)] = 1
    """N: every Nth run keeps its table of beams, from which the statistics are computed; 1: every run."""

    def _check(self) -> None:
        drawn = list[str]()
        for place, keys in (
            *((f"dispersions.{key}", [key]) for key in self.dispersions),
            *((f"joint_normals.{i}.keys", joint.keys) for i, joint in enumerate(self.joint_normals)),
        ):
            for key in keys:
                if key in self.set or key in drawn:
                    raise unusable(place, Finding(f"{key} twice"), "state each key once")
                for other in drawn:
                    if self._replaces(key, other) or self._replaces(other, key):
                        found = Finding(f"drawn beside {other}")
                        raise unusable(
                            place, found, "draw a key or keys below it: one would replace the other"
                        )
                drawn.append(key)
        seen = set[str]()
        for i, correlation in enumerate(self.correlations):
            for key in correlation.keys:
                if key not in self.dispersions or key in seen:
                    raise unusable(
                        f"correlations.{i}.keys", key, "keys of dispersions, each in one correlation"
                    )
                seen.add(key)

    def _replaces(self, key: str, other: str) -> bool:
        """Whether a key lies below another one whose drawn values contain it. Keys below the name of a part, such as
        the power of a drawn instrument, act on that part."""
        if not key.startswith(f"{other}."):
            return False
        above = self.dispersions.get(other)
        return not (isinstance(above, Choice) and all(isinstance(name, str) for name in above.of))

    @property
    def drawn_keys(self) -> list[str]:
        """All keys that are drawn, in the order of the file."""
        return [*self.dispersions, *(key for joint in self.joint_normals for key in joint.keys)]

    @property
    def factors(self) -> dict[str, str]:
        """The factor of each drawn key: the key itself, or all keys that are drawn jointly with it, since Sobol indices
        are defined for independent factors only."""
        groups: list[Correlation | JointNormal] = [*self.correlations, *self.joint_normals]
        joint = {key: " + ".join(group.keys) for group in groups for key in group.keys}
        return {key: joint.get(key, key) for key in self.drawn_keys}

    @property
    def factor_names(self) -> list[str]:
        """Each factor once, in the order of the file."""
        return list(dict.fromkeys(self.factors.values()))


def _check_ascending(low: float, high: float) -> None:
    if not low < high:
        raise unusable("high", high, f"above low, {low:g}")


def _check_square(matrix: _Matrix, key: str, size: int) -> None:
    if len(matrix) != size or any(len(row) != size for row in matrix):
        raise unusable(key, Finding("wrong size"), f"state {size} rows of {size} numbers")
    for i in range(size):
        for j in range(i):
            if matrix[i][j] != matrix[j][i]:
                raise unusable(f"{key}.{i}.{j}", matrix[i][j], f"{matrix[j][i]:g}, as in row {j}: symmetric")

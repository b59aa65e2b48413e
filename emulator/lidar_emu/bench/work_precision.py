"""The Pareto front of time and error, and the cheapest sufficient setting."""

from __future__ import annotations

from collections.abc import Sequence

Point = tuple[float, float]
"""Time and error."""


def pareto_front(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other point dominates, from fast to slow.

    Points with NaN are beaten by any; of equal points the first is on the front.
    """
    known = [i for i, (time, error) in enumerate(points) if time == time and error == error]
    front: list[int] = []
    for i in sorted(known, key=lambda i: points[i]):
        if not front or points[i][1] < points[front[-1]][1]:
            front.append(i)
    return front


def cheapest(
    times: Sequence[float], errors: Sequence[Sequence[float]], targets: Sequence[float]
) -> int | None:
    """Index of the fastest whose errors are all at most their targets; None if there is none."""
    able = [
        i
        for i, found in enumerate(errors)
        if all(error <= target for error, target in zip(found, targets, strict=True))
    ]
    return min(able, key=lambda i: times[i], default=None)

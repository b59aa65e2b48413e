"""Intervals of a probability that is known from counts."""

from __future__ import annotations


def exact_interval(hits: int, tries: int, doubt: float) -> tuple[float, float]:
    """Interval of a probability (Clopper and Pearson 1934), or both of its one-sided bounds.

    Args:
        hits: number of tries that hit.
        tries: number of tries; without any, the interval is 0 to 1.
        doubt: probability on each side that the bound is wrong, at most.
    """
    return _beta_quantile(hits, tries - hits + 1, doubt), _beta_quantile(hits + 1, tries - hits, 1 - doubt)


def _beta_quantile(first: int, second: int, share: float) -> float:
    """Quantile of the beta distribution, or 0 or 1 without it."""
    from scipy.special import betaincinv

    return float(betaincinv(first, second, share)) if first and second else float(first > 0)

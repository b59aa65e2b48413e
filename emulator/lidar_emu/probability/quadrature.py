"""Quadrature over panels on which the integrand is smooth."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def nodes_and_weights(edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights of every panel.

    Args:
        edges: (..., panels + 1) edges of the panels, ascending.

    Returns:
        Nodes and weights, (..., 16 panels).
    """
    half = 0.5 * np.diff(edges)[..., None]
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])[..., None]
    shape = (*edges.shape[:-1], -1)
    return (middle + half * _NODES).reshape(shape), (half * _WEIGHTS).reshape(shape)

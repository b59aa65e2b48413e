"""Below these limits a stage of the receiver is left out, beam by beam."""

from __future__ import annotations

LEAST_SMEAR_BINS = 0.05
"""A beat that changes by less during its record is left unsmeared: 0.8 % of the line's amplitude beside it."""

LEAST_LINE_DRIFT = 0.01
"""A smaller phase variance of the laser over the delay is left out: 1 % of the echo's power."""

LEAST_FALSE_ALARM = 1e-9
"""Peaks of noise that matter with a smaller probability are not drawn."""

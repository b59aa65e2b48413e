"""Colours of beams, the same in every figure and viewer."""

from __future__ import annotations

BEAM_COLOURS = ("#3b82d6", "#e8603c", "#c99700", "#2aa775", "#9a6dd7", "#7f8790", "#c2558f", "#14a3b8")
"""Colours by beam, repeated when there are more; visible on white and on black.

The first four are distinct with each kind of colour blindness (CIE 1976 distance 16 or more).
"""


def beam_colour(beam: int) -> str:
    """Return the colour of a beam as `#rrggbb`."""
    return BEAM_COLOURS[beam % len(BEAM_COLOURS)]


def beam_rgb(beam: int) -> tuple[int, int, int]:
    """Return the colour of a beam as red, green and blue, 0 to 255."""
    red, green, blue = bytes.fromhex(beam_colour(beam)[1:])
    return red, green, blue

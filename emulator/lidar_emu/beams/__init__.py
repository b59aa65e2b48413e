"""Flight geometry: where each beam starts, where it points and what it hits, computed or read from a recording."""

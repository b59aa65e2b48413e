"""The geometry of a flight, recorded apart from the light: written, read, and flown again."""

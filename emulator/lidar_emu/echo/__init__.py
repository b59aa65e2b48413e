"""Echoes: the beamlets of each beam, dust raised by the plume, and the spread of the spectrum."""

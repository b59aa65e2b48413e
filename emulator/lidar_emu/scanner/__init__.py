"""Beam patterns, their switching, and the sampling of a beam's footprint."""

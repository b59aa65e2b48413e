"""Whole records: analog receiver, laser, detection in all bins, and estimation by exhaustive search.

Slow and exact, for level `reference` and custom detectors. No module here uses a beat frequency, a fold or the
transform of a window.
"""

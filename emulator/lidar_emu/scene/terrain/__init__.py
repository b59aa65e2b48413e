"""Elevation files: reading them, and placing them in the site frame."""

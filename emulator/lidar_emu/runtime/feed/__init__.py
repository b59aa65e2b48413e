"""Feeds: where the shots of a run come from, and how they reach the port process."""

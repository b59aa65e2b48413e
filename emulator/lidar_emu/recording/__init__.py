"""Recordings of runs, captures and CAN logs: write, read, replay, recompute."""

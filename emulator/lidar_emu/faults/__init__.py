"""Faults on order: a schedule, and functions that act on what they are given."""

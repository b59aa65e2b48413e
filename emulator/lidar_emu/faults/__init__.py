"""Injected faults: when they act, and their effects on light, receiver, measurements and packets."""

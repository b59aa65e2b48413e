"""Probabilities of detection, of false alarms and of false locks, in closed form, for planning."""

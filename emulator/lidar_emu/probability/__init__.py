"""Probabilities of detection, of false alarms and of false locks: closed forms for planning, nothing drawn."""

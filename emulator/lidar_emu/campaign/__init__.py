"""Campaigns: Monte Carlo runs of one scenario, simulated by many processes, stored and summarised."""

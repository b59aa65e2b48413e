"""Campaigns: Monte Carlo runs of one scenario, drawn, flown by many processes, stored and summarised."""

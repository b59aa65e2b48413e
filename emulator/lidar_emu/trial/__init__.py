"""Trials of a flight computer: cases that it flies against the emulated lidar, and the grade of its solutions."""

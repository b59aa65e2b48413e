"""Benchmarks of the emulator itself: accuracy, speed and timing."""

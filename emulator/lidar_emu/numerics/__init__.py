"""Numerics that all stages share: kernels, random streams, rotations, vectors and array types."""

"""Packets by kernels: an interface as tables of numbers, and the kernel that encodes measurements by them."""

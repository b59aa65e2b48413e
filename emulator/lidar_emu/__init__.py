"""A stand-in for a multi-beam FMCW Doppler landing lidar."""

__version__ = "0.1.0"

"""The reference: light of scatterers that are scattered over the surface and fixed to it.

Each scatterer has the two-way amplitude and phase of the Gaussian mode in the beam's own coordinates, from the beam's
poses at emission, scattering and reception. The package has no echo law, speckle, skip rule, haze noise or spectral bin
of the faster levels, and no motion but the trajectory's poses.
"""

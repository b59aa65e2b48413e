"""The receiver: echoes of the beamlets, link budget, spectra, detection, estimation of range and closing speed."""

"""The FMCW receiver: link budget, spectra, detection, estimation of range and closing speed."""

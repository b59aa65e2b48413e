"""What the receiver makes of the light: echo power, spectra, targets, range and closing speed."""

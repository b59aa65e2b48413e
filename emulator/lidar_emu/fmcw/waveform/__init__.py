"""The waveform level: range and speed sample by sample, slow and exact, as a reference for the spectral level.

No module here uses a beat frequency, a fold or the transform of a window: records are sampled from the laser's phase,
filtered, digitised and transformed. The level shares with the spectral path only the scenario's schema, the reasons,
the echo field and the conversion of light and noise to SNR.
"""

"""The waveform level: range and speed sample by sample, slow and exact, as a reference for the spectral level.

Nothing here knows a beat frequency, a fold or a window's transform: records are sampled from the laser's phase,
filtered, digitised and transformed. It shares the scenario's schema, the reasons, the echo's field and the
conversion of light and noise to SNR with the spectral path, and no more.
"""

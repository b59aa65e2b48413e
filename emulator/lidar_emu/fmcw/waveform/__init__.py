"""The slow way from light to range and speed, sample by sample: what the spectral receiver is held against.

Nothing here knows a beat frequency, a fold or a window's transform: records are sampled from the laser's phase,
filtered, digitised and transformed. It shares the scenario's schema, the reasons, the echo's field and what a watt of
light and the chain's noise come to with the spectral path, and no more.
"""

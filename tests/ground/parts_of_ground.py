"""What the tests ask for."""

RELIEF = {"hurst": 0.76, "rms_slope_deg": 3.0, "baseline_m": 10.0}
CRATERS = {"age_gyr": 3.5}
MOON_ROCKS = {"kind": "power_law", "per_m2_over_1_m": 2e-2, "exponent": 2.11}
MARS_ROCKS = {"kind": "golombek", "abundance": 0.15}

"""Constants of nature, exact by the definition of the SI."""

from __future__ import annotations

PLANCK_J_S = 6.626_070_15e-34
BOLTZMANN_J_PER_K = 1.380_649e-23
ELEMENTARY_CHARGE_C = 1.602_176_634e-19

"""Truth, extremes and whole flights are modules of these tests; the instruments are those of the receiver's."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "fmcw")]

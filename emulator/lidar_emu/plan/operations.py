"""Operations of a run by kind, and the time that each takes."""

from __future__ import annotations

from dataclasses import dataclass

_COSTS = {
    "beams": (1.2e-6, "beams pointed and reported"),
    "rays": (0.07e-6, "rays and their echoes"),
    "bins of bands": (40e-9, "bins of haze"),
    "nodes of bands": (0.3e-6, "parts of bands of haze and dust"),
    "records": (1.5e-6, "records"),
    "tones": (0.06e-6, "tones"),
    "bins": (0.03e-6, "bins"),
    "tones in bins": (0.5e-9, "tones in bins"),
    "taps in bins": (0.5e-9, "taps of smear and linewidth in bins"),
    "nodes of taps": (15e-9, "nodes of the integrals of smear taps"),
    "beamlet samples": (42e-9, "samples of beamlets"),
    "receiver samples": (290e-9, "samples with their run-in behind the poles"),
}
"""Time of one operation of each kind on a core of a 2.5 GHz Xeon, from `tools/run_times.py`, and its name."""


@dataclass(frozen=True)
class Operations:
    """Number of operations of a run by kind."""

    count: dict[str, float]

    @property
    def seconds(self) -> dict[str, float]:
        """Time by kind."""
        return {kind: number * _COSTS[kind][0] for kind, number in self.count.items()}

    @property
    def total_s(self) -> float:
        """Time of all operations."""
        return sum(self.seconds.values())

    @property
    def dominant(self) -> str:
        """Kind that takes the most time, with its share and number, for people."""
        seconds = self.seconds
        most = max(seconds, key=lambda kind: seconds[kind])
        share = seconds[most] / self.total_s if self.total_s else 0.0
        return f"{100 * share:.0f} % for {self.count[most]:.2g} {_COSTS[most][1]}"

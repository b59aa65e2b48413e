"""One thing that cannot be used, and the good files that it breaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

FLIGHT = """\
name: hop
duration_s: 5
timing: {rate_hz: 20, epoch: 2030-01-01T00:00:00Z}
instrument:
  waveform: {segment_time_s: 300e-6, fft_length: 131072}
  optics: {beamlets: 1}
  receiver: {responsivity_a_per_w: 1.0}
  detection: {window: hann, maximum_range_m: 12000}
site:
  ground: {kind: plane, slope_deg: 1}
scanner:
  pattern: {kind: square, angle_deg: 20}
  firing: together
trajectory:
  kind: profile
  waypoints:
    - {altitude_m: 200, speed_mps: 20}
    - {altitude_m: 100, speed_mps: 10}
"""
BENCH = """\
name: bench
bench_pattern:
  duration_s: 1
  beams:
    - {range_m: 100, closing_speed_mps: 5}
"""
SITE = "site:\n  ground: {kind: plane, slope_deg: 1}"
SIMULATE = "simulate my.yaml --out out.csv"

Content = str | bytes | Callable[[Path], None]
"""What a file holds, or what writes it."""


@dataclass(frozen=True)
class Case:
    """Files, a command line, and what its one line on stderr must contain."""

    name: str
    expected: tuple[str, ...]
    files: dict[str, Content] = field(default_factory=dict)
    command: str = SIMULATE

    def write_files(self, folder: Path) -> None:
        """Lay the files out."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(exist_ok=True)
            if isinstance(content, str | bytes):
                path.write_bytes(content.encode() if isinstance(content, str) else content)
            else:
                content(path)


def changed(text: str, old: str, new: str) -> str:
    """`text` with one place changed."""
    assert text.count(old) == 1, (old, text.count(old))
    return text.replace(old, new)

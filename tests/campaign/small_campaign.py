"""Campaigns that are flown in no time, and a pool that does what a test asks of it."""

from __future__ import annotations

from concurrent.futures import BrokenExecutor, Future
from pathlib import Path

SMALL = """\
name: small
scenario: descent.yaml
set: {{site: flat, duration_s: 0.4, instrument.optics.beamlets: 1}}
runs: {runs}
seed: 5
dispersions:
  site.surface.reflectance: {{kind: uniform, low: 0.1, high: 0.3}}
  trajectory.waypoints.0.altitude_m: {{kind: normal, mean: 900, sigma: 60, low: 800}}
  wire.unit: {{kind: integer, low: 0, high: 15}}
  instrument: {{kind: choice, of: [ndl_four_beam, ndl_fine]}}
"""
ROWS = 32
"""Beams of a small run."""


class Here:
    """A pool in this process; `dies` decides on which work its workers die."""

    worker_errors: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, slots=1, dies=lambda _work, _args: False):
        self.slots, self.dies = slots, dies
        self.flown = []

    def submit(self, work, *args):
        future = Future()
        self.flown.append((work.__name__, args))
        if self.dies(work, args):
            future.set_exception(BrokenExecutor("gone"))
            return future
        try:
            future.set_result(work(*args))
        except Exception as error:
            future.set_exception(error)
        return future

    def replace_workers(self):
        pass

    def close(self):
        pass


def content(folder: Path) -> dict[str, bytes]:
    """Every file by its name below the folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}

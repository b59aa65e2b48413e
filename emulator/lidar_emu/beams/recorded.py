"""A flight with beams and hits read from a geometry file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.edges import CellCutter, CutBeams
from lidar_emu.beams.flight import Flight
from lidar_emu.beams.geometry_file import GeometryFile, require_same
from lidar_emu.beams.patterns import ScannerState
from lidar_emu.beams.pointing import Pointing
from lidar_emu.errors import InputError
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.ray_hits import Hits


class RecordedFlight(Flight):
    """A flight with recorded pointing, patterns and hits; the scanner's state passes through unchanged.

    Raises:
        InputError: the file holds no geometry, or the geometry of a different flight.
    """

    def __init__(self, scenario: FlightScenario, path: Path) -> None:
        self.file = GeometryFile(path)
        require_same(scenario, self.file.metadata.conditions, str(path))
        super().__init__(scenario)

    @property
    def recorded_geometry(self) -> GeometryFile:
        return self.file

    @property
    def has_moving_objects(self) -> bool:
        return self.file.metadata.moving

    def point(
        self, shot: NDArray[np.int64], state: ScannerState, follows_chirps: bool = False
    ) -> tuple[Pointing, ScannerState]:
        """See `Flight`; misalignment faults are part of the recorded pointing."""
        pointing = self.file.pointing(shot)
        if not follows_chirps:
            pointing = pointing._replace(at_chirps=pointing.at_chirps[:, :, :0, :0])
        return pointing, state

    def patterns(self, shot: NDArray[np.int64], _state: ScannerState) -> IntArray:
        return self.file.pointing(shot).pattern

    def cast(self, pointing: Pointing) -> Hits:
        return self.file.axis_hits(pointing.shot)

    def cast_beamlets(
        self, pointing: Pointing, _start_site_m: FloatArray, _ray_site: FloatArray, hits: Hits
    ) -> Hits:
        return self.file.beamlet_hits(pointing.shot, hits)

    def cut_cells(
        self,
        _cutter: CellCutter,
        pointing: Pointing,
        _axis_range_m: FloatArray,
        _rays: tuple[FloatArray, FloatArray],
        _hits: Hits,
    ) -> CutBeams | None:
        return self.file.cut_beams(pointing.shot)

    def _check_ground_coverage(self) -> None:
        """Skip the check: recorded hits are NaN where a beam has no ground."""

    def _count_shots(self) -> int:
        recorded, duration_s = self.file.metadata.shots, self.scenario.duration_s
        shots = recorded if duration_s is None else self.scenario.timing.shots_within(duration_s)
        if shots > recorded:
            longest_s = recorded * self.period_ns * 1e-9
            remedy = f"must be at most {longest_s:g}, as recorded in {self.file.path}"
            raise InputError(self.scenario.name, "duration_s", duration_s, remedy)
        return shots

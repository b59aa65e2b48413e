"""Record the geometry of a flight: beam directions and hits."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lidar_emu.beams.geometry_file import BLOCK_SHOTS, GeometryMetadata, GeometryWriter, conditions
from lidar_emu.files import whole_file
from lidar_emu.receiver.echoes import EchoModel
from lidar_emu.scenario.load import require_known_flight
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import Progress


def record_geometry(
    scenario: FlightScenario, path: Path, progress: Progress | None = None
) -> GeometryMetadata:
    """Write the geometry of a flight, a block at a time.

    All beamlets of the instrument are written, including those that the plan leaves out: another instrument may need
    them. Where the plan samples the footprint by more, all of these are.

    Returns:
        The metadata of the file.

    Raises:
        InputError: the flight cannot be built, is live, or `path` cannot be written.
        RunError: writing failed on the way.
    """
    require_known_flight(scenario)
    model = FlightModel(scenario)
    beamlets = max(model.plan.beamlets, scenario.instrument.optics.beamlets)
    flight = model.flight
    echo_model = EchoModel(scenario.instrument, scenario.site, flight, beamlets)
    metadata = GeometryMetadata(
        shots=flight.shot_count,
        beams=model.beam_count,
        beamlets=beamlets,
        moving=flight.has_moving_objects,
        edges=echo_model.columns > beamlets,
        name=scenario.name,
        conditions=conditions(scenario),
    )
    state = model.initial_state
    with whole_file(path) as file:
        writer = GeometryWriter(file, metadata)
        for first in range(0, flight.shot_count, BLOCK_SHOTS):
            shot = np.arange(first, min(first + BLOCK_SHOTS, flight.shot_count), dtype=np.int64)
            pointing, state = model.aim(shot, state, follows_chirps=True)
            axis_hits = flight.cast(pointing)
            beamlet_hits = echo_model.cast_beamlets(pointing, axis_hits)
            writer.add(pointing, axis_hits, beamlet_hits, echo_model.cut_beams)
            if progress is not None:
                progress(int(shot[-1]) + 1, flight.shot_count)
        writer.close()
    return metadata

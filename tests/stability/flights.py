"""Whole flights at their extremes: steep ground, spin, ground without light."""

from __future__ import annotations

from typing import Any

import numpy as np
from beat_truth import BeatTruth, beat_truth
from outcomes import ANYWHERE, Extreme, Outcome, check_report, compare, joined

from lidar_emu.beams.pointing import BeamVectors
from lidar_emu.bench.stability import over_level_ground
from lidar_emu.numerics.vector_arrays import cross
from lidar_emu.receiver.returns import Reason
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import measure_whole

_STILL: dict[str, Any] = {"optics": {"speckle": False}, "waveform": {"linewidth_hz": 0.0}}
_FINE = {"peak": "hann", "combine": "least_squares"}
_SPEED_MPS = 40.0
_TREE = {
    "name": "extreme",
    "instrument": _STILL | {"detection": _FINE},
    "site": {"ground": {"kind": "plane"}},
    "scanner": {"pattern": {"kind": "square", "angle_deg": 22.5}},
}


def _flight(shots: int, **changes: Any) -> FlightModel:
    """Straight down from 1000 m with 40 m/s, attitude and instrument as asked; `shots` shots."""
    duration_s = shots / 20
    flown = over_level_ground(1000.0 - _SPEED_MPS * duration_s, (_SPEED_MPS, _SPEED_MPS), duration_s)
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    scenario = load(_TREE, flown | keys)
    assert isinstance(scenario, FlightScenario)
    return FlightModel(scenario)


def _outcome(model: FlightModel) -> Outcome:
    """Against 40 digits for the beams' axes over a plane: ranges and speeds change with the turning beam."""
    run = measure_whole(model)
    check_report(run, model.scenario.instrument.detection.maximum_range_m)
    for name in ("true_range_m", "true_closing_speed_mps", "point_site_m"):
        assert not np.isinf(getattr(run, name)).any(), name
    rows = np.flatnonzero(run.range_valid & run.sign_resolved)
    truth = _truth(model, rows)
    tones = np.zeros((len(rows), 3))
    waveform = model.scenario.instrument.waveform
    return compare(run, truth, rows, tones, waveform.wavelength_m * waveform.sample_rate_hz / 2)


def _truth(model: FlightModel, rows: np.ndarray) -> BeatTruth:
    pointing, _ = model.flight.point(np.arange(model.shot_count), model.initial_state)
    hits = model.flight.cast(pointing)
    turn = cross(pointing.turning_site_radps, pointing.true_site)
    normal, axis, velocity = hits.normal_site, pointing.true_site, pointing.sensor_velocity_site_mps
    sinking = np.sum(normal * (velocity + hits.range_m[..., None] * turn), axis=-1)
    columns = (
        hits.range_m,
        np.sum(velocity * axis, axis=-1),
        -sinking / np.sum(normal * axis, axis=-1),
        np.sum(velocity * turn, axis=-1)
        + np.sum(BeamVectors(*pointing.beams).acceleration_mps2 * axis, axis=-1),
    )
    if not len(rows):
        return BeatTruth(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)))
    return beat_truth(model.scenario.instrument.waveform, *(column.ravel()[rows] for column in columns))


def _slopes(slopes_deg: tuple[float, ...], **changes: Any) -> Outcome:
    """A beam straight down, that meets the ground below at the incidence of its slope."""
    pattern = {"scanner__pattern": {"kind": "directions", "beams": [[0, 0]]}}
    return joined(
        [
            _outcome(_flight(20, site__ground={"kind": "plane", "slope_deg": s}, **pattern, **changes))
            for s in slopes_deg
        ]
    )


def _level(shots: int = 40, **changes: Any) -> Outcome:
    return _outcome(_flight(shots, **changes))


def _spin(shots: int, *rate_radps: float) -> Outcome:
    """One beam 22.5 degrees off the boresight."""
    pattern = {"kind": "ring", "count": 1, "angle_deg": 22.5}
    return _level(shots, trajectory__attitude={"body_rate_radps": rate_radps}, scanner__pattern=pattern)


_BRIGHT = {"instrument": _STILL | {"detection": _FINE, "optics": {"speckle": False, "laser_power_w": 1e6}}}
_DARK = {"instrument": {"optics": {"laser_power_w": 1e-300}}}
_VALID = frozenset({Reason.VALID})
_TURNED = _VALID | {Reason.BELOW_THRESHOLD, Reason.NO_SURFACE, Reason.BEYOND_RANGE, Reason.AMBIGUOUS}
_SILENT = frozenset({Reason.BELOW_THRESHOLD})
_STEEP, _GRAZING = (0.0, 30.0, 60.0), (80.0, 89.0, 89.9, 89.99)

FLIGHTS = [
    Extreme("incidence 0 to 60 degrees, flight", _VALID, lambda: _slopes(_STEEP), beside=(5e-3, 1e-4)),
    Extreme(
        "incidence 80 to 89.99 degrees, flight, 1 MW",
        _TURNED,
        lambda: _slopes(_GRAZING, **_BRIGHT),
        resolved=False,
        beside=(200.0, 2.0),
    ),
    Extreme(
        "incidence 80 to 89.99 degrees, flight, all defaults",
        _TURNED,
        lambda: _slopes(_GRAZING, instrument={}),
        resolved=False,
        beside=(200.0, 2.0),
    ),
    Extreme(
        "spin of 60 rad/s about the boresight, flight",
        _TURNED,
        lambda: _spin(1, 0.0, 0.0, 60.0),
        resolved=False,
        beside=ANYWHERE,
    ),
    Extreme(
        "spin of 1 rad/s about all axes, flight",
        _TURNED,
        lambda: _spin(40, 1.0, -1.0, 1.0),
        resolved=False,
        beside=ANYWHERE,
    ),
    Extreme(
        "reflectance 0, flight, all defaults",
        _SILENT,
        lambda: _level(instrument={}, site__surface={"reflectance": 0.0}),
    ),
    Extreme(
        "reflectance 1, flight",
        _VALID,
        lambda: _level(site__surface={"reflectance": 1.0}),
        beside=(5e-3, 1e-4),
    ),
    Extreme("laser power 1e-300 W, flight", _SILENT, lambda: _level(**_DARK)),
    Extreme(
        "beams to the sky, flight",
        frozenset({Reason.NO_SURFACE}),
        lambda: _level(trajectory__attitude={"roll_deg": 180.0}),
    ),
]

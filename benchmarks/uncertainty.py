"""Tables of docs/evidence/uncertainty.md: the uncertainty sheet beside the receiver's shots.

A shot of a scenario is measured again and again with other speckle and noise, from places along each beam and at speeds
along it that differ by up to a bin, so that beats are anywhere in a bin. A beam's errors are taken without false locks:
within ten times the 95 % half-width that the sheet states.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import scanner, trajectory
from benchmarks.tables import machine
from lidar_emu.beams.patterns import ScannerState
from lidar_emu.beams.pointing import Pointing
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan.uncertainty import COVERAGE, CombinedUncertainty, Sheet, shot_at, uncertainty_at
from lidar_emu.receiver.returns import FACE, Echoes
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.flight_model import FlightModel

_BLOCK = 2000
_VIBRATED_S = 100.0
_FALSE_LOCK = 10.0


class Case(NamedTuple):
    """A measurement of beam 0: a scenario, changed keys, and an altitude in m."""

    scenario: str
    keys: dict[str, str]
    altitude_m: float


_FINE = {"instrument": "ndl_fine"}
_ALONG = "along_x: {g_rms: 1}, along_y: {g_rms: 1}, along_z: {g_rms: 1}"
CASES = {
    "near: `descent`, `ndl_fine`": Case("descent", _FINE, 40.0),
    "far: `descent`": Case("descent", {}, 1800.0),
    "far, `ndl_fine`": Case("descent", _FINE, 1800.0),
    "45° over a roughness of 5 cm, `ndl_fine`": Case(
        "descent", _FINE | {"scanner": scanner(45.0), "site.surface.roughness_m": "0.05"}, 200.0
    ),
    "120 m/s, braking at 1 g, `ndl_fine`": Case(
        "descent", _FINE | {"trajectory": trajectory(1000.0, 500.0, 120.0, 40.0)}, 1000.0
    ),
    "200 m/s, braking at 2.7 g, `ndl_fine`": Case(
        "descent", _FINE | {"trajectory": trajectory(1000.0, 600.0, 200.0, 80.0)}, 1000.0
    ),
    "crater wall: `terrain_step_2023`": Case("terrain_step_2023", {}, 3000.0),
    "`ndl_as_flown`, 1 g rms of vibration": Case(
        "descent", {"instrument": "ndl_as_flown", "vibration": f"{{{_ALONG}}}"}, 500.0
    ),
}

_QUIET = {
    "instrument": "ndl_fine",
    "instrument.waveform.linewidth_hz": "0",
    "instrument.optics.speckle": "off",
    "instrument.optics.laser_power_w": "100",
    "trajectory": trajectory(500.0, 100.0, 30.0),
}
SOURCES = {
    "quantisation": {"instrument.detection.peak": "bin"},
    "noise": {"instrument.optics.laser_power_w": "1"},
    "speckle": {"instrument.optics.speckle": "on"},
    "line": {"instrument.waveform.linewidth_hz": "3e3"},
    "sweep": {"instrument.waveform.slope_scatter": "1.2e-4"},
}
"""Keys that add one source to an instrument that has no other: no line, no speckle, and 100 W."""


class _FreshSpeckle:
    """Echoes whose speckle is another one in each shot, although the sensor hardly moves."""

    def __init__(self, echo_model: Any) -> None:
        self._echo_model = echo_model

    def __getattr__(self, name: str) -> Any:
        return getattr(self._echo_model, name)

    def echoes(self, *arguments: Any) -> Echoes:
        echoes: Echoes = self._echo_model.echoes(*arguments)
        echoes.speckle_place[..., FACE] = 0.0
        return echoes


class ShotAgain(FlightModel):
    """The whole chain for one shot of a scenario, repeated."""

    def __init__(self, scenario: FlightScenario, shot: int) -> None:
        super().__init__(scenario.model_copy(update={"faults": []}))
        self._shot = shot
        self._random = np.random.default_rng(shot)
        self.echo_model: Any = _FreshSpeckle(self.echo_model)

    def aim(
        self, shot: NDArray[np.int64], state: ScannerState, follows_chirps: bool | None = None
    ) -> tuple[Pointing, ScannerState]:
        """The one shot of beam 0, with places and velocities along it that differ."""
        one, state = super().aim(np.array([self._shot]), state, follows_chirps)
        count, waveform = len(shot), self.scenario.instrument.waveform
        tiled = {"pattern": 0, "time_ns": 0, "in_gap": 0, "fired": 0, "angle_deg": 0, "site_from_body": 0}
        tiled |= {"beams": 1, "vehicle": 1, "at_chirps": 2}
        arrays: dict[str, Any] = {
            name: np.repeat(getattr(one, name), count, axis=axis) for name, axis in tiled.items()
        }
        arrays["fired"][:, 1:] = False
        axis = one.true_site
        units = np.array([waveform.range_bin_m, waveform.speed_bin_mps])
        along = units * self._random.uniform(-0.5, 0.5, (count, axis.shape[1], 2))
        for stacked in (arrays["beams"], *np.moveaxis(arrays["at_chirps"], 1, 0)):
            if stacked.size:
                stacked[0] += along[..., :1] * axis
                stacked[1] += along[..., 1:] * axis
        if self.scenario.vibration is not None:
            arrays["time_ns"] += self._random.integers(0, round(_VIBRATED_S * 1e9), (count, 1))
        return one._replace(shot=shot, **arrays), state


def shots_again(case: Case, count: int) -> tuple[Sheet, FloatArray, float]:
    """The sheet of a case; errors (2, n) of range and closing speed of the valid ones of `count` shots; and their
    share."""
    scenario = load(case.scenario, case.keys)
    assert isinstance(scenario, FlightScenario)
    model = ShotAgain(scenario, 0)
    model._shot, _ = shot_at(scenario, model.flight, case.altitude_m)
    errors = []
    for first in range(0, count, _BLOCK):
        measured, _ = model.measure(first, min(_BLOCK, count - first), model.initial_state)
        error = np.stack(
            [
                measured.range_m - measured.true_range_m,
                measured.closing_speed_mps - measured.true_closing_speed_mps,
            ]
        )
        valid = measured.range_valid & measured.speed_valid
        errors.append(error[..., 0][:, valid[:, 0]])
    joined = np.concatenate(errors, axis=1)
    return uncertainty_at(scenario, case.altitude_m, 0), joined, joined.shape[1] / count


def without_false_locks(error: FloatArray, stated: CombinedUncertainty) -> FloatArray:
    """Errors less the systematic one that the sheet states."""
    beside = error - stated.systematic
    return np.asarray(beside[np.abs(beside) < _FALSE_LOCK * stated.half_width_95])


def _compared(said: tuple[float, float], seen: FloatArray) -> Iterator[str]:
    """Cells of the two widths in mm or mm/s."""
    for one, other in zip(said, seen, strict=True):
        yield f"{1e3 * one:.3g}, {1e3 * other:.3g}"
        yield f"{100.0 * (one / other - 1.0):+.1f} %"


def parts(shots: int) -> Iterator[tuple[str, ...] | str]:
    """Rows of the table of cases."""
    yield (
        *("measurement", "valid: sheet, shots", "error", "systematic: sheet, mean of shots"),
        *("U 68.27 %: sheet, shots", "difference", "U 95 %: sheet, shots", "difference", "false locks"),
    )
    for name, case in CASES.items():
        sheet, errors, valid = shots_again(case, shots)
        about = name, f"{100.0 * sheet.detected:.1f}, {100.0 * valid:.1f} %"
        both = (
            ("range, mm", errors[0], sheet.range_error_m),
            ("speed, mm/s", errors[1], sheet.speed_error_mps),
        )
        for quantity, error, stated in both:
            right = without_false_locks(error, stated)
            systematic = f"{1e3 * stated.systematic:+.3g}, {1e3 * (stated.systematic + right.mean()):+.3g}"
            cells = _compared(
                (stated.half_width_68, stated.half_width_95), np.quantile(np.abs(right), COVERAGE)
            )
            yield *about, quantity, systematic, *cells, f"{1e6 * (1.0 - right.size / error.size):.0f} ppm"
            about = "", ""
    yield machine()


def source_parts(shots: int) -> Iterator[tuple[str, ...] | str]:
    """Rows of the table of single sources."""
    yield "source", "error", "u: sheet, shots", "difference", "95 %: sheet, shots", "difference"
    for name, keys in SOURCES.items():
        sheet, errors, _ = shots_again(Case("descent", _QUIET | keys, 500.0), shots)
        row = next(source for source in sheet.sources if source.name == name)
        for quantity, error, stated, part in (
            ("range, mm", errors[0], sheet.range_error_m, row.range_m),
            ("speed, mm/s", errors[1], sheet.speed_error_mps, row.speed_mps),
        ):
            right = without_false_locks(error, stated)
            found = np.quantile(np.abs(right), COVERAGE)
            if row.has_variance:
                found[0] = right.std()
            yield name, quantity, *_compared((part.uncertainty, part.half_width_95), found)
    yield machine()

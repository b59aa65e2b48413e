"""Table of docs/evidence/uncertainty.md: quantiles of the uncertainty sheet beside those of the receiver's shots.

A shot of a scenario is measured again and again with other speckle and noise, from places and at speeds that differ by
up to 32 bins, so that beats are anywhere in a bin. A beam's errors are taken without false locks: within ten times the
95 % quantile that the sheet states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.patterns import ScannerState
from lidar_emu.beams.pointing import Pointing
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.receiver.returns import FACE, Echoes
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.flight_model import FlightModel

_BLOCK = 2000
_PLACES_BIN = 64.0
_VIBRATED_S = 100.0


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
        """The one shot, with places and velocities along the vertical that differ."""
        one, state = super().aim(np.array([self._shot]), state, follows_chirps)
        count, waveform = len(shot), self.scenario.instrument.waveform
        tiled = {"pattern": 0, "time_ns": 0, "in_gap": 0, "fired": 0, "angle_deg": 0, "site_from_body": 0}
        tiled |= {"beams": 1, "vehicle": 1, "at_chirps": 2}
        arrays: dict[str, Any] = {
            name: np.repeat(getattr(one, name), count, axis=axis) for name, axis in tiled.items()
        }
        units = np.array([waveform.range_bin_m, waveform.speed_bin_mps])[:, None]
        up_m, up_mps = units * self._random.uniform(-0.5 * _PLACES_BIN, 0.5 * _PLACES_BIN, (2, count))
        for stacked in (arrays["beams"], *np.moveaxis(arrays["at_chirps"], 1, 0)):
            if stacked.size:
                stacked[0, ..., 2] += up_m[:, None]
                stacked[1, ..., 2] += up_mps[:, None]
        if self.scenario.vibration is not None:
            arrays["time_ns"] += self._random.integers(0, round(_VIBRATED_S * 1e9), (count, 1))
        return one._replace(shot=shot, **arrays), state


def shots_again(scenario: FlightScenario, shot: int, count: int) -> tuple[FloatArray, FloatArray]:
    """Errors (2, count, beams) of range and closing speed of valid measurements of one shot, NaN for others; and the
    share of valid ones (beams,)."""
    model = ShotAgain(scenario, shot)
    blocks: list[Measurement] = []
    for first in range(0, count, _BLOCK):
        blocks.append(model.measure(first, min(_BLOCK, count - first), model.initial_state)[0])
    errors = []
    for measured in blocks:
        error = np.stack(
            [
                measured.range_m - measured.true_range_m,
                measured.closing_speed_mps - measured.true_closing_speed_mps,
            ]
        )
        errors.append(np.where(measured.range_valid & measured.speed_valid, error, np.nan))
    joined = np.concatenate(errors, axis=1)
    return joined, np.isfinite(joined[0]).mean(axis=0)

"""The levels of the receiver that measure echoes: how much is computed between echoes and measurement.

`geometric` reports the truth of each beam's axis, `spectral` computes the relevant bins of the spectra; `reference` has
no echoes (`reference.level`). A level imports only the modules that it needs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidar_emu.receiver.receiver_model import ALL_BEAMLETS
from lidar_emu.receiver.returns import Echoes, Reason, Returns
from lidar_emu.scenario.schema import FlightScenario

if TYPE_CHECKING:
    from lidar_emu.receiver.custom_detection import Detector

Level = Callable[[Echoes, NDArray[np.int64]], Returns]
"""Measures beams (shots, beams) of shots (shots,)."""

# Plain numbers: numpy takes microseconds to convert a member of an enumeration.
_VALID = int(Reason.VALID)
_NOT_FIRED = int(Reason.NOT_FIRED)
_NO_SURFACE = int(Reason.NO_SURFACE)
_BELOW_THRESHOLD = int(Reason.BELOW_THRESHOLD)
_BEYOND_RANGE = int(Reason.BEYOND_RANGE)
_INSIDE_GROUND = int(Reason.INSIDE_GROUND)


def build_level(
    scenario: FlightScenario, ground_beamlets: int = ALL_BEAMLETS, detector: Detector | None = None
) -> Level:
    """Build the level that the scenario selects, for footprints of `ground_beamlets` beamlets.

    Args:
        detector: custom detector; None: the instrument's.

    Raises:
        InputError: the instrument is impossible.
    """
    if scenario.level == "geometric":
        maximum_range_m = scenario.instrument.detection.maximum_range_m
        return lambda echoes, _shot: geometric(echoes, maximum_range_m)
    from lidar_emu.receiver.receiver_constants import build_receiver
    from lidar_emu.receiver.vibration import with_vibration

    in_turn = scenario.scanner.firing == "in_turn"
    model = build_receiver(
        scenario.instrument, scenario.site, scenario.left_out_share, in_turn, ground_beamlets
    )
    model = with_vibration(model, scenario.vibration, scenario.instrument)
    if detector is not None:
        from lidar_emu.receiver.own_detector_receiver import OwnDetectorReceiver

        return OwnDetectorReceiver(model, scenario.seed, scenario.instrument, detector)
    from lidar_emu.receiver.receiver import FmcwReceiver

    return FmcwReceiver(model, scenario.seed)


def geometric(echoes: Echoes, maximum_range_m: float) -> Returns:
    """Report the truth of each beam's axis, its first beamlet, at the time of validity."""
    range_m, speed_mps = echoes.range_m[..., 0], echoes.closing_speed_mps[..., 0]
    reason = np.full(echoes.fired.shape, _VALID, dtype=np.int8)
    with np.errstate(invalid="ignore"):
        reason[range_m > maximum_range_m] = _BEYOND_RANGE
        reason[np.isnan(range_m)] = _NO_SURFACE
        reason[echoes.inside | (range_m <= 0)] = _INSIDE_GROUND
    reason[~echoes.fired] = _NOT_FIRED
    valid = reason == _VALID
    exact = np.where(valid, 0.0, np.nan)
    return Returns.with_columns(
        valid.shape,
        range_m=np.where(valid, range_m, np.nan),
        closing_speed_mps=np.where(valid, speed_mps, np.nan),
        range_valid=valid,
        speed_valid=valid,
        sign_resolved=valid,
        reason=reason,
        segments=np.where(valid, 7, 0).astype(np.uint8),
        residual_mps=exact,
        sigma_range_m=exact,
        sigma_speed_mps=exact,
        returns=valid.astype(np.uint8),
        second_reason=np.where(
            (reason == _INSIDE_GROUND) | (reason == _NOT_FIRED), reason, _BELOW_THRESHOLD
        ).astype(np.int8),
    )

"""Samples and spectra of a chosen shot."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

from lidar_emu.errors import InputError
from lidar_emu.fmcw.waveform.own_detector import SEGMENTS, SegmentSpectrum
from lidar_emu.scenario.load import load
from lidar_emu.scenario.required import require_known_flight
from lidar_emu.scenario.schema import Scenario
from lidar_emu.shots.model import build_model, state_before


def shot_spectra(
    scenario: str | PathLike[str] | Mapping[str, Any] | Scenario,
    shot: int,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> dict[int, dict[str, SegmentSpectrum]]:
    """Compute the spectra of one shot, the same from which `simulate` takes its measurement.

    Level waveform gives samples and all bins, level spectral the bins around the tones. At level spectral noise peaks
    outside these bins are not included.

    Args:
        scenario: see `load`; most shipped scenarios need `level="waveform"` for samples.
        overrides: see `load`.
        keys: see `load`.
        shot: number of the shot.

    Returns:
        Spectra by number of the beam and by segment: `up`, `constant`, `down`. A beam that is not measured, because it
        does not fire or touches the ground, is left out.

    Raises:
        InputError: see `simulate`; or there is no such shot, or the level has no spectra.
    """
    known = load(scenario, overrides, **keys)
    require_known_flight(known)
    found: dict[int, dict[str, SegmentSpectrum]] = {}

    def keep(spectrum: SegmentSpectrum) -> list[float]:
        found.setdefault(spectrum.beam, dict.fromkeys(SEGMENTS, spectrum))[spectrum.segment] = spectrum
        return []

    model = build_model(known, detector=keep)
    if isinstance(shot, bool) or not isinstance(shot, int) or not 0 <= shot < model.shot_count:
        allowed = f"must be a whole number from 0 to {model.shot_count - 1}"
        raise InputError("shot_spectra", "shot", shot, allowed)
    model.measure(shot, 1, state_before(model, shot))
    return found

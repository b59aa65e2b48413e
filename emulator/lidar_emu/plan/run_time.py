"""Prediction of a run's computing time from the operations that it will carry out.

Operations are counted from the scenario and a sample of its flight; each kind has a time that was measured once. The
prediction is meant to be right within a factor of two on a core of the machine that the documentation names
(`docs/evidence/accuracy.md`); it excludes start and compilation.
"""

from __future__ import annotations

import numpy as np

from lidar_emu.echo.spectral_spread import Spread
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.returns import Echoes
from lidar_emu.numerics.arrays import BoolArray
from lidar_emu.numerics.records import as_record
from lidar_emu.plan.motion import largest
from lidar_emu.plan.operations import Operations
from lidar_emu.plan.speckle_exchange import grown_beam_drift_per_s
from lidar_emu.scenario.schema import FlightScenario

_STREAKS = 1
"""Beamlets that `echo.dust` adds, in an interval of bins of their own."""

_EXTENT_RMS = 5.0
"""Width of the beamlets' spectrum in rms widths of the footprint's."""


def count_operations(
    scenario: FlightScenario, shots: int, echoes: Echoes, spread: Spread, beamlets: int
) -> Operations:
    """Count the operations of a run of `shots` shots.

    Args:
        scenario: scenario of the run.
        shots: number of shots.
        echoes: echoes sampled along the flight, (samples, beams, 1).
        spread: spectral spread of the same beams.
        beamlets: number of beamlets that the run uses.
    """
    fired = echoes.fired
    beams = shots * fired.mean() * fired.shape[1]
    lit = fired & np.isfinite(echoes.range_m[..., 0])
    measured = shots * lit.mean() * lit.shape[1]
    count = {"beams": beams, "rays": beams * beamlets}
    level = scenario.level
    each = {}
    if level == "waveform":
        each = _waveform(scenario, echoes, beamlets)
    elif level != "geometric" and lit.any():
        each = _frequencies(scenario, echoes, spread, beamlets, lit)
    return Operations(count | {kind: measured * number for kind, number in each.items()})


def _band_nodes(scenario: FlightScenario) -> float:
    """Parts of the bands of haze and dust whose highest bins a beam measurement draws."""
    from lidar_emu.fmcw.volume_peaks import DUST_NODES, HAZE_NODES

    # Haze is a line in the constant segment.
    return 2.0 * HAZE_NODES * _is_hazy(scenario) + 3.0 * DUST_NODES * (scenario.plume is not None)


def _is_hazy(scenario: FlightScenario) -> bool:
    air = scenario.site.atmosphere
    return air is not None and air.backscatter_per_m_sr > 0.0


def _padded(beamlets: int) -> int:
    """Tones of a record: the beamlets and the haze, in whole divisions."""
    from lidar_emu.fmcw.close_tones import TONES_PER_DIVISION

    return -(-(beamlets + 1) // TONES_PER_DIVISION) * TONES_PER_DIVISION


def _frequencies(
    scenario: FlightScenario, echoes: Echoes, spread: Spread, beamlets: int, lit: BoolArray
) -> dict[str, float]:
    """Operations of a beam measurement at level statistical or spectral, mean over the sampled beams."""
    from lidar_emu.fmcw.receiver_constants import build_receiver

    model = build_receiver(scenario.instrument, scenario.site, scenario.tolerated_share)
    records = 3.0 * model.looks
    each = _tones_per_beamlet(scenario, model, echoes, beamlets, lit)
    count = {"records": records, "tones": records * each * _padded(beamlets)}
    nodes = _band_nodes(scenario)
    if nodes > 0.0:
        count["nodes of bands"] = nodes
    if scenario.level == "spectral":
        count |= _bins(scenario, model, echoes, spread, beamlets, lit, each)
    return count


def _bins(
    scenario: FlightScenario,
    model: ReceiverModel,
    echoes: Echoes,
    spread: Spread,
    beamlets: int,
    lit: BoolArray,
    each: float,
) -> dict[str, float]:
    """Operations on the bins of a spectrum, for `each` tones of a beamlet."""
    from lidar_emu.fmcw.bin_filter import set_widest_filters
    from lidar_emu.fmcw.motion_smear import LEAST_TAPS, integral_nodes
    from lidar_emu.fmcw.spectrum import REACH

    waveform, looks = scenario.instrument.waveform, model.looks
    range_m, speed_mps = echoes.range_m[..., 0][lit], echoes.closing_speed_mps[..., 0][lit]
    smear_mps2 = np.nan_to_num(echoes.closing_acceleration_mps2[lit])
    power_w = echoes.power_w[..., 0][lit]
    half = np.empty(len(range_m))
    set_widest_filters(as_record(model), range_m, speed_mps, smear_mps2, power_w, half)
    taps = np.where(half > 0.0, 2.0 * half + 1.0, 0.0)
    nodes = np.vectorize(integral_nodes, otypes=[float])(half)
    # Between looks the surface comes nearer and changes its speed, and their bins are computed together.
    lasting_s = (looks - 1) * waveform.cycle_time_s
    width = abs(speed_mps) * lasting_s / waveform.range_bin_m
    width += abs(echoes.closing_acceleration_mps2[lit]) * lasting_s / waveform.speed_bin_mps
    if beamlets > 1:
        width += _EXTENT_RMS * spread.widest()[lit]
    interval = 2.0 * (REACH + np.maximum(0.0, half - LEAST_TAPS)) + 1.0
    tones, bins = each * _padded(beamlets), interval + width
    if scenario.plume is not None:
        tones, bins = each * _padded(beamlets + _STREAKS), bins + _STREAKS * interval
    hazy = np.minimum(range_m, model.haze.computed_range_m) * model.beat_bin_per_m
    bins = np.minimum(bins + 2.0 / 3.0 * hazy, 0.5 * waveform.fft_length)
    records = 3.0 * looks
    return {
        "tones": records * tones,
        "bins": records * float(bins.mean()),
        "bins of bands": 2.0 * looks * float(hazy.mean()),
        "tones in bins": records * tones * float(bins.mean()),
        "taps in bins": records * float((taps * (bins + taps)).mean()),
        "nodes of taps": records * float(nodes.mean()),
    }


def _tones_per_beamlet(
    scenario: FlightScenario, model: ReceiverModel, echoes: Echoes, beamlets: int, lit: BoolArray
) -> float:
    """Tones of a beamlet by the change of its speckle within a record, mean over the sampled beams."""
    from lidar_emu.fmcw.speckle_change import count_tones

    drift_per_s = echoes.speckle_drift_per_s
    if beamlets > 1:
        drift_per_s = grown_beam_drift_per_s(scenario.instrument, echoes)
    drift_per_s = drift_per_s[lit]
    tones = np.empty(len(drift_per_s))
    count_tones(as_record(model), drift_per_s, echoes.power_w[..., 0][lit], tones)
    return float(tones.mean())


def _waveform(scenario: FlightScenario, echoes: Echoes, beamlets: int) -> dict[str, float]:
    """Samples of a beam measurement, of three records with their run-in."""
    from lidar_emu.fmcw.waveform.analog_receiver import AnalogResponse, oversampling

    waveform = scenario.instrument.waveform
    response = AnalogResponse.of(scenario.instrument.receiver)
    samples = waveform.fft_length
    if not response.flat:
        highest_bin = largest(echoes.range_m) / waveform.range_bin_m
        highest_bin += largest(echoes.closing_speed_mps) / waveform.speed_bin_mps
        samples += response.run_in(waveform.sample_rate_hz)
        samples *= oversampling(waveform, highest_bin * waveform.bin_width_hz)
    return {"beamlet samples": 3.0 * beamlets * samples, "receiver samples": 3.0 * samples}

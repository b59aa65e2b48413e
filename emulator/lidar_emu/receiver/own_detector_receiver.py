"""Level spectral with a detector of the user's own: the kernel's spectra, one after the other, in Python."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.kernels import kernel, with_fields
from lidar_emu.receiver.beam_measurement import BEAM_RETURN, set_beam
from lidar_emu.receiver.custom_detection import SEGMENTS, Detector, SegmentSpectrum, detected
from lidar_emu.receiver.exhaustive_estimation import nothing, to_beam_result
from lidar_emu.receiver.receiver import FmcwReceiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import RETURN_COLUMNS, Echoes, Reason, Returns, contiguous_echoes
from lidar_emu.receiver.segment_spectrum import lay_spectra, set_spectrum
from lidar_emu.receiver.spectrum import BIN, NOISE, POWER
from lidar_emu.receiver.workspace import Workspace, as_workspace
from lidar_emu.scenario.instrument import Instrument


class OwnDetectorReceiver(FmcwReceiver):
    """Measures as `FmcwReceiver` does, with the targets that a callable finds in the computed bins.

    Noise peaks and haze in bins that are not computed are left out.
    """

    def __init__(self, model: ReceiverModel, seed: int, instrument: Instrument, detector: Detector) -> None:
        super().__init__(model, seed)
        self._instrument, self._detector = instrument, detector
        self._set_spectra: Any = _set_spectra

    def __call__(self, echoes: Echoes, shot: NDArray[np.int64]) -> Returns:
        echoes = contiguous_echoes(echoes)
        self._reserve(echoes)
        beams = [self._beam(echoes, int(shot[s]), s, b) for s, b in np.ndindex(echoes.fired.shape)]
        columns = {name: np.concatenate([getattr(beam, name) for beam in beams]) for name in RETURN_COLUMNS}
        return Returns(**{name: a.reshape(*echoes.fired.shape, *a.shape[1:]) for name, a in columns.items()})

    def _beam(self, echoes: Echoes, shot: int, s: int, b: int) -> Returns:
        row = np.zeros(1, dtype=BEAM_RETURN)
        model, waveform = self.model, self._instrument.waveform
        found, level = [], np.full(waveform.fft_length // 2 + 1, float(model.noise_power))
        beam = tuple(echoes), shot, self._seed, s, b
        if not self._set_spectra(self._records, self._work, *beam, with_fields(row)):
            return nothing(Reason(int(row["reason"][0])))
        arrays = dict(zip(Workspace._fields, self._work, strict=True))
        grids, ends = arrays["grid"], arrays["ends"]
        for segment, name in enumerate(SEGMENTS):
            grid = grids[segment, :, : ends[segment, ends[segment, 0]]].astype(np.float64)
            inner = (grid[BIN] >= 0.0) & (grid[BIN] <= 0.5 * model.fft_length)
            frequency_hz = grid[BIN, inner] * model.bin_width_hz
            noise = grid[NOISE, inner] * model.noise_power
            power, least = grid[POWER, inner].copy(), noise * model.threshold
            spectrum = SegmentSpectrum(shot, b, name, frequency_hz, power, noise, least, None, None)
            found.append(detected(self._detector, spectrum, waveform))
            level[np.rint(grid[BIN, inner]).astype(np.int64)] = noise
        measured = to_beam_result(
            waveform, self._instrument.detection, (found[0], found[1], found[2]), level, model.residual_limit
        )
        if measured.reason[0] == Reason.BELOW_THRESHOLD:
            measured.reason[0] = row["reason"][0]
        return measured


@kernel(outermost=True)
def _set_spectra(
    models: NDArray[Any],
    work_arrays: tuple[Any, ...],
    echo_arrays: tuple[Any, ...],
    shot: int,
    seed: np.uint64,
    s: int,
    b: int,
    rows: NDArray[Any],
) -> bool:
    """Set the spectra of a beam; return whether there is anything to measure."""
    model, work, echoes = models[0], as_workspace(work_arrays), Echoes(*echo_arrays)
    beam = work.beam[0]
    beam.seed, beam.shot = seed, shot
    if not set_beam(model, work, echoes, s, b, rows[0]):
        return False
    lit = lay_spectra(model, work, beam, echoes, s, b)
    for segment in range(3):
        if lit:
            set_spectrum(model, work, beam, segment)
        else:
            work.ends[segment, 0] = 0
    return True

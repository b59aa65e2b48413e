"""Errors in metres, metres per second and probability of detection by what a plan leaves out."""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.kernels import interpreted
from lidar_emu.plan import LeftOut
from lidar_emu.receiver.peak_interpolation import noise_bin2, rounding_bin2
from lidar_emu.receiver.range_speed_estimation import BEAT_WEIGHTS
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import Echoes
from lidar_emu.scenario.schema import FlightScenario


class BeatErrors(NamedTuple):
    """What errors of beats and losses of power do to measurements, at most."""

    variance_bin2: float
    """Variance of a beat by noise and rounding, of the weakest beam; noise moves a detected peak by a bin at most."""
    range_m: tuple[float, float]
    """Error by 1 bin in all beats: of independent ones, and of any."""
    speed_mps: tuple[float, float]
    detection_slope: float
    """Change of the probability of a valid measurement per relative change of power."""

    def scatter(self, variance_bin2: float, power_loss: float = 0.0) -> LeftOut:
        """Error by independent errors of beats with this variance, and of a relative loss of power."""
        deviation_bin = sqrt(variance_bin2)
        detected = min(1.0, self.detection_slope * power_loss)
        return LeftOut(deviation_bin * self.range_m[0], deviation_bin * self.speed_mps[0], detected)

    def line(self, share: float) -> LeftOut:
        """Error by lines whose width makes peaks wander by this share of the variance of beats.

        The peak of a line of rms width s bins wanders by s/√2 and is lower by π² s²/3.
        """
        variance_bin2 = share * self.variance_bin2
        return self.scatter(variance_bin2, min(1.0, 2.0 * pi**2 / 3.0 * variance_bin2))

    def bias(self, shift_bin: float, power_loss: float = 0.0) -> LeftOut:
        """Error by shifts of beats by this much each, and of a relative loss of power."""
        detected = min(1.0, self.detection_slope * power_loss)
        return LeftOut(shift_bin * self.range_m[1], shift_bin * self.speed_mps[1], detected)


def beat_errors(scenario: FlightScenario, echoes: Echoes) -> BeatErrors:
    """Derive the effects of errors of beats from echoes sampled along a flight, with one beamlet per beam."""
    instrument = scenario.instrument
    model = build_receiver(instrument, scenario.site)
    near = echoes.range_m[..., 0] <= instrument.detection.maximum_range_m
    power_w = echoes.power_w[..., 0][near & (echoes.power_w[..., 0] > 0.0)]
    faintest = max(float(power_w.min(initial=np.inf)) * model.snr_per_w, 1e-30)
    noise_variance = min(interpreted(noise_bin2)(model.peak_method, faintest), 1.0)
    weights = BEAT_WEIGHTS[model.combine_method]
    range_independent, _ = np.sqrt((weights**2).sum(axis=-1).max(axis=0))
    range_any, speed_any = np.abs(weights).sum(axis=-1).max(axis=0)
    return BeatErrors(
        noise_variance + interpreted(rounding_bin2)(model.peak_method),
        (float(range_independent) * model.range_bin_m, float(range_any) * model.range_bin_m),
        # Least squares takes speed from the Doppler line alone where the chirps scatter more.
        (model.speed_bin_mps, float(speed_any) * model.speed_bin_mps),
        steepest_detection(model.threshold, instrument.detection.looks, speckle=instrument.optics.speckle),
    )


def steepest_detection(threshold: float, looks: int, *, speckle: bool) -> float:
    """Largest change of the probability of a valid measurement per relative change of the echoes' power.

    A sum of M powers around the mean M S scatters by √(2 M S) with noise alone, and by √M S in speckle. The steepest
    slope of a normal distribution of that width is S = T times its density in the middle, 0.4; three segments that must
    all hold the echo, or two of them, make it 1.5 times as steep at most.

    Args:
        threshold: T, mean power of the looks in noise powers.
        looks: M.
        speckle: whether echoes fade.
    """
    return 0.6 * sqrt(looks) if speckle else 0.6 * sqrt(0.5 * looks * threshold) + 0.2
